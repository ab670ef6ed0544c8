"""A configuration whose rig holds what its model file lacks, with a short menu of experiments."""

from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "configs" / "reference_rig.yaml"
STRIBECK = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 6.0}


def written(
    folder: Path,
    bus: str = "{interface: virtual, channel: investigate}",
    limits: str = "{load_n: 0, rack_travel_m: 0.02, matters: 0.1}",
) -> Path:
    """The configuration file."""
    content = yaml.safe_load(REFERENCE.read_text())
    content["model"]["effects"] = [STRIBECK]
    (folder / "rig.yaml").write_text(yaml.safe_dump(content))
    path = folder / "c.yaml"
    path.write_text(f"""\
bus: {bus}
dbc: {ROOT / "dbc" / "eps_rig.dbc"}
signals: {ROOT / "configs" / "eps_rig_signals.yaml"}
model: {REFERENCE}
investigate: {limits}
rig: {{manoeuvre: idle, loop: true, model: rig.yaml, order: 2, realtime: false}}
""")
    return path
