"""Rows of a batch on disk: one file each as it is done, two Parquet tables in the end."""

import json
from collections.abc import Sequence
from pathlib import Path

from eps_hil import json_text
from eps_hil.fleet.job import Row
from eps_hil.recordings.files import needs_extra, replacing

_HEAD = (
    "recording", "unit", "state", "error", "verdict", "start_s", "seconds", "notes", "output",
    "key",
)  # fmt: skip
_VALUE = ("quantity", "value", "low", "high", "si")


class Store:
    """The folder of a batch. A row that is there is not computed again."""

    def __init__(self, out: Path) -> None:
        self._rows = out / "rows"
        self._out = out
        self._rows.mkdir(parents=True, exist_ok=True)

    def known(self, key: str) -> Row | None:
        """The row of that key from an earlier run; None where there is none, or half of one."""
        try:
            row = json_text.parse((self._rows / f"{key}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        whole = isinstance(row, dict) and row.get("key") == key
        return row if whole and self._there(row) else None

    def keep(self, row: Row) -> None:
        """Write one row, whole or not at all."""
        with replacing(self._rows / f"{row['key']}.json") as temporary:
            temporary.write_text(json.dumps(row), encoding="utf-8")

    def tables(self, rows: Sequence[Row]) -> tuple[Path, Path]:
        """``results.parquet``, a row a recording; ``values.parquet``, a row a quantity of one."""
        results, values = self._out / "results.parquet", self._out / "values.parquet"
        with needs_extra(results, "parquet"):
            import pyarrow
            import pyarrow.parquet
        text, real = pyarrow.string(), pyarrow.float64()
        kinds = {"start_s": real, "seconds": real, "value": real, "low": real, "high": real}
        heads = [
            {name: row.get(name) for name in _HEAD} | {"notes": "; ".join(row.get("notes", ()))}
            for row in rows
        ]
        long = [
            {"recording": row["recording"], "unit": row["unit"], "start_s": row["start_s"]}
            | {name: one[name] for name in _VALUE}
            for row in rows
            for one in row["values"]
        ]
        for path, names, content in (
            (results, _HEAD, heads),
            (values, ("recording", "unit", "start_s", *_VALUE), long),
        ):
            schema = pyarrow.schema([(name, kinds.get(name, text)) for name in names])
            with replacing(path) as temporary:
                table = pyarrow.Table.from_pylist(content, schema=schema)
                pyarrow.parquet.write_table(table, temporary)
        return results, values

    def _there(self, row: Row) -> bool:
        return not row["output"] or row["state"] != "done" or (self._out / row["output"]).exists()
