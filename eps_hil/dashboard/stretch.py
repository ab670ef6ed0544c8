"""Diagnoses one stretch, in a process of its own that the page's server starts, hears and ends.

    python -m eps_hil.dashboard.stretch

The order comes as one line of JSON on stdin (:class:`~eps_hil.dashboard.order.Order`), progress and
the end go to stdout as lines of JSON: ``{"stage", "part"}``, then ``{"done": true}`` or
``{"error": "..."}``. When stdin is closed the process ends at once. ``result.json`` and
``page.html`` are written to a folder.
"""

import json
import os
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from eps_hil.dashboard.order import PAGE, RESULT, SAMPLES, Order
from eps_hil.series import Series

NICE = 19


def work(order: Order, tell: Callable[[Mapping[str, Any]], None]) -> None:
    """Diagnose, and write what was found; what is wrong with the samples is told in one line."""
    tell({"stage": "reading the samples", "part": 0.0})
    from eps_hil.diagnosis.diagnose import diagnose
    from eps_hil.errors import EpsHilError
    from eps_hil.physics.model import load_model
    from eps_hil.report import diagnosis_page, page
    from eps_hil.report.diagnosis_summary import summary

    folder = Path(order.folder)
    try:
        model = load_model(order.model)
        series = _samples(order)
        if not series:
            raise EpsHilError("nothing was recorded in this stretch")
        start_ns = min(int(one.t_ns[0]) for one in series.values())
        found = diagnose(
            model,
            {order.name: series},
            {},
            lambda stage, part: tell({"stage": stage, "part": part}),
        )
        tell({"stage": "drawing the page", "part": 0.97})
        values, plots = diagnosis_page.values_of(found)
        page.write(folder / PAGE, diagnosis_page.filled(values, plots, Path(order.model).name))
        content = summary(found, values["cards"], values["measures"], values["verdict"])
        content |= _drawn(content.pop("samples"), start_ns)
    except (EpsHilError, ValueError) as error:
        tell({"error": " ".join(str(error).split())})
        return
    (folder / RESULT).write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")
    tell({"done": True})


def _drawn(samples: Mapping[str, Any], start_ns: int) -> dict[str, Any]:
    """Map and strip of both models, as the page draws its own."""
    import numpy as np

    from eps_hil.dashboard.mismatch import map_of, strip_of

    left_n = {name: samples[name] for name in ("before", "after")}
    t_ns = start_ns + np.rint(samples["time_s"] * 1e9).astype(np.int64)
    return {
        "start_s": start_ns * 1e-9,
        "map": map_of(samples["x"], samples["y"], left_n, 0.0),
        "strip": strip_of(t_ns, left_n),
    }


def _samples(order: Order) -> dict[str, Series]:
    """All signals of the stretch as they were stamped."""
    import numpy as np

    if order.recording is None:
        with np.load(Path(order.folder) / SAMPLES) as kept:
            names = [name for name in kept.files if not name.endswith("|t_ns")]
            return {name: Series(kept[f"{name}|t_ns"], kept[name]) for name in names}
    from eps_hil.recordings.read import read_recording

    whole = read_recording(
        order.recording,
        dbc=[Path(one) for one in order.dbc],
        signals=None if order.signals is None else Path(order.signals),
        gaps="mark",
        ignore_unknown=True,
    )
    found = {}
    for name, one in whole.series.items():
        cut = slice(*np.searchsorted(one.t_ns, (order.begin_ns, order.end_ns + 1)).tolist())
        if cut.stop - cut.start > 1:
            found[name] = Series(one.t_ns[cut], one.value[cut])
    return found


def main() -> None:
    """Take the order, and end when whoever gave it is gone."""
    given = json.loads(sys.stdin.readline())
    order = Order(**{**given, "dbc": tuple(given["dbc"])})
    threading.Thread(target=_until_closed, daemon=True).start()
    os.nice(NICE)

    def tell(what: Mapping[str, Any]) -> None:
        sys.stdout.write(json.dumps(what) + "\n")
        sys.stdout.flush()

    work(order, tell)


def _until_closed() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    main()
