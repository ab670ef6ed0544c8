"""What the page's server asks a diagnosing process for."""

import json
from dataclasses import asdict, dataclass

RESULT, PAGE, SAMPLES = "result.json", "page.html", "samples.npz"


@dataclass(frozen=True, slots=True)
class Order:
    """What to diagnose: a stretch of a ``recording``, or else the samples in ``folder``.

    Instants are physical ones, by the clock of the stamps, ns.
    """

    name: str
    begin_ns: int
    end_ns: int
    model: str
    folder: str = ""
    recording: str | None = None
    dbc: tuple[str, ...] = ()
    signals: str | None = None

    def line(self) -> bytes:
        """For the process' stdin."""
        return json.dumps(asdict(self)).encode() + b"\n"
