"""Rows of a batch on disk: one file each as it is done, Parquet tables in the end."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eps_hil import json_text
from eps_hil.fleet.job import Row
from eps_hil.recordings.files import needs_extra, replacing

_HEAD = (
    "recording", "unit", "state", "error", "verdict", "start_s", "seconds", "notes", "output",
    "key",
)  # fmt: skip
_VALUE = ("quantity", "value", "low", "high", "si")
_LONG = ("recording", "unit", "start_s", *_VALUE)
_STATES = ("recordings_before", "recordings_after")
_CHANGE = (
    "unit", "start_s", "change", "effect", "parameter", "before", "before_low", "before_high",
    "after", "after_low", "after_high", "si", "size_after", "confidence", "holdout_gain",
    "holdout_gain_low", "holdout_gain_high", "confusable_with", "seen_in",
)  # fmt: skip
_REAL = {
    "start_s", "seconds", "value", "low", "high", "before", "before_low", "before_high", "after",
    "after_low", "after_high", "size_after", "confidence", "holdout_gain", "holdout_gain_low",
    "holdout_gain_high",
}  # fmt: skip


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

    def tables(self, rows: Sequence[Row], *, states: bool = False) -> tuple[Path, ...]:
        """``results.parquet``, a row a recording; ``values.parquet``, a row a quantity of one.

        Of units in two ``states`` a row a unit, and ``changes.parquet``, a row a number that has
        changed (:mod:`eps_hil.fleet.changed`), or one that says nothing has.
        """
        results, values = self._out / "results.parquet", self._out / "values.parquet"
        with needs_extra(results, "parquet"):
            import pyarrow
            import pyarrow.parquet
        names, lists = (*_HEAD, *_STATES) if states else _HEAD, ("notes", *_STATES * states)
        heads = [
            {name: row.get(name) for name in names}
            | {name: "; ".join(row.get(name, ())) for name in lists}
            for row in rows
        ]
        long = [
            {"recording": row["recording"], "unit": row["unit"], "start_s": row["start_s"]}
            | {name: one[name] for name in _VALUE}
            for row in rows
            for one in row["values"]
        ]
        tables: list[tuple[Path, Sequence[str], list[dict[str, Any]]]]
        tables = [(results, names, heads), (values, _LONG, long)]
        if states:
            changed = [
                {"unit": row["unit"], "start_s": row["start_s"], **one}
                for row in rows
                for one in row["changes"]
            ]
            tables.append((self._out / "changes.parquet", _CHANGE, changed))
        for path, columns, content in tables:
            kinds = [pyarrow.float64() if one in _REAL else pyarrow.string() for one in columns]
            schema = pyarrow.schema(list(zip(columns, kinds, strict=True)))
            with replacing(path) as temporary:
                table = pyarrow.Table.from_pylist(content, schema=schema)
                pyarrow.parquet.write_table(table, temporary)
        return tuple(path for path, *_ in tables)

    def _there(self, row: Row) -> bool:
        return not row["output"] or row["state"] != "done" or (self._out / row["output"]).exists()
