"""Signals -> MCAP, which PlotJuggler and Foxglove open: JSON messages under a JSON schema.

One topic, one message for each stamp, with the signals that have a sample there. PlotJuggler
shows them as ``/eps_hil/rack_force_n`` and so on, the names that the live stream has too.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eps_hil.recordings.files import needs_extra
from eps_hil.recordings.json_rows import TOPIC, row, schema_of
from eps_hil.recordings.table import from_series
from eps_hil.series import Series
from eps_hil.signals import CANONICAL
from eps_hil.version import VERSION

_ROWS = 50_000


def write_mcap(
    path: Path,
    series: Mapping[str, Series],
    *,
    source: str = "",
    carriers: Mapping[str, str] | None = None,
) -> None:
    """Write every sample at its own stamp (integer nanoseconds); a bad one (NaN) is left out.

    ``carriers``: the CAN message of each signal, told in the schema's descriptions.
    """
    with needs_extra(path, "mcap"):
        from mcap.writer import Writer
    t_ns, columns = from_series(series)
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(library=f"eps_hil {VERSION}")
        schema = writer.register_schema(
            f"{TOPIC}.signals", "jsonschema", json.dumps(schema_of(series, carriers)).encode()
        )
        units = {name: CANONICAL[name].unit for name in series if name in CANONICAL}
        channel = writer.register_channel(f"/{TOPIC}", "json", schema, {"source": source, **units})
        for begin in range(0, len(t_ns), _ROWS):
            part = slice(begin, begin + _ROWS)
            values = {name: column[part].tolist() for name, column in columns.items()}
            for k, stamp in enumerate(t_ns[part].tolist()):
                told = row({name: column[k] for name, column in values.items()})
                if told:
                    writer.add_message(channel, stamp, json.dumps(told).encode(), stamp)
        writer.finish()
