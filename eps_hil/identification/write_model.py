"""The identified model as a model file, with its friction map and where each number came from."""

from collections.abc import Sequence
from typing import Any

import yaml

from eps_hil.identification.result import Identification
from eps_hil.physics.model import dump_model


def model_file(found: Identification, source: str, recordings: Sequence[str]) -> str:
    """The file's text: the ``model`` block of CONTRACT 4, and beside it two further keys.

    ``friction_map`` holds the measured map (2Q-map); ``provenance`` each number's interval, status
    and the value that the file ``source`` had.
    """
    content = found.map.content()["cells"]
    cells = [
        {
            "speed_rad_s": _short(cell["speed_rad_s"]),
            "load_n": _short(cell["load_n"]),
            "friction_nm": _short(cell["friction_nm"]),
            "ci95": None if cell["ci95"] is None else [_short(x) for x in cell["ci95"]],
            "seconds": round(cell["seconds"], 2),
        }
        for cell in content
    ]
    provenance: dict[str, Any] = {
        "by": "eps-hil identify",
        "from_model": source,
        "recordings": list(recordings),
        "delay_reference": found.delay_reference or None,
        "parameters": {
            name: {
                "status": one.status,
                "old_value": one.from_model,
                "ci95": None if one.ci95 is None else [_short(x) for x in one.ci95],
            }
            for name, one in found.parameters.items()
        },
        "findings": [one.summary for one in found.findings],
    }
    beside = {"friction_map": cells, "provenance": provenance}
    return (
        dump_model(found.model)
        + "# measured friction over speed and load, at the rotor; positive against the motion\n"
        + yaml.safe_dump(beside, sort_keys=False, allow_unicode=True)
    )


def _short(value: float) -> float:
    return float(f"{value:.6g}")
