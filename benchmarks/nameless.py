"""What a diagnosis models of physics that the catalogue has no name for.

    python benchmarks/nameless.py [--sizes 1.5 3 8] [--seeds 11] [--decoys 2] [--out FILE]

Each case is a rig of the proof's truth plant (which shares no code with what is examined) with one
hidden family, and the whole diagnosis is run on it. Its oracle is the same rig with nothing hidden:
no model of the effect can leave less of the hold-out than that does, nor estimate the rack force
better. *Share*: of what the oracle takes off the hold-out's mean square. *Force*: of the oracle's
gain in rack-force error. Both by the written model file on the uncorrected hold-out. *Run*:
error of the angle in a free run over the whole hold-out ÷ what it was before. *Place*: the first
place told is a signal that the effect depends on. *Law*: named, or written with its own inputs and
memory. ``--out`` keeps a line of JSON for each case, and goes on with what such a file holds.
Printed as a Markdown table, one row a family.
"""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from eps_hil.diagnosis.accept.proof_of_fit import Holdout, measures
from eps_hil.diagnosis.data.intake import prepared
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model, dump_model, load_model
from eps_hil.proof.cases import make
from eps_hil.proof.effects import LATER, NAMELESS
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.plans import DECOYS, Plan
from eps_hil.proof.truth import Drive, Floats
from eps_hil.series import Series

_SPEED, _ANGLE, _PLACE = "motor_speed_rad_s", "motor_angle_rad", "rack_position_m"
_TORQUE, _SENSOR, _FORCE = "motor_torque_nm", "torque_sensor_nm", "rack_force_n"


@dataclass(frozen=True)
class True_:
    """What a family depends on: its signals, of which memory, and the name it goes by."""

    signals: tuple[str, ...]
    memory: str = "none"
    name: str = ""


TRUE: Mapping[str, True_] = {
    "alien_bushing": True_((_ANGLE,), "hysteresis", "hysteretic bushing (Bouc–Wen)"),
    "alien_dead_time": True_((_TORQUE,), name="inverter dead time"),
    "alien_driven_loss": True_((_TORQUE, _SPEED), name="mesh efficiency, driving against driven"),
    "alien_eddy_brake": True_((_SPEED,), name="eddy-current brake"),
    "alien_guide": True_((_SENSOR,), name="rack-guide friction"),
    "alien_heat_loss": True_((_TORQUE,), "heat", "current fold-back"),
    "alien_iron_play": True_((_TORQUE,), "play", "iron losses with play in torque"),
    "alien_load_memory": True_((_FORCE,), "lag", "friction that follows the load late"),
    "alien_load_ripple": True_((_FORCE, _ANGLE), name="ripple that grows with the load"),
    "alien_one_way_drag": True_((_SPEED, _PLACE), name="position-dependent damping"),
    "alien_ripple": True_((_ANGLE, _TORQUE), name="torque ripple of another order"),
    "alien_speed_memory": True_((_SPEED,), "lag", "velocity-memory friction"),
    "alien_thinning": True_((_SPEED, _FORCE), "heat", "grease that warms"),
    "alien_thrust": True_((_FORCE,), name="thrust bearing under load"),
    "alien_travel_drag": True_((_SPEED, _PLACE), name="position-dependent damping"),
    "alien_unbalance": True_((_SPEED, _ANGLE), name="unbalance"),
    "alien_weakening": True_((_SPEED, _TORQUE), name="field weakening"),
    "last_column_rub": True_((_SENSOR,)),
    "last_fading_cogging": True_((_ANGLE, _SPEED)),
    "last_power_limit": True_((_TORQUE, _SPEED)),
    "last_screw_travel": True_((_FORCE, _PLACE)),
    "late_braking_loss": True_((_TORQUE, _SPEED)),
    "late_film": True_(("since_reversal_s", _SPEED)),
    "late_film_peak": True_((_SPEED,)),
    "late_iron_loss": True_((_TORQUE, _SPEED), name="iron losses of the motor"),
    "late_magnet": True_(("time_s", _TORQUE)),
    "late_nut_loss": True_((_FORCE, _SPEED)),
    "late_one_way_gain": True_((_TORQUE,)),
    "late_seal": True_((_FORCE,)),
    "late_wet_drag": True_((_SPEED,), "lag"),
    "late_worn_tooth": True_((_ANGLE, _PLACE)),
}
"""The rack's position is the rotor's angle, and a sign of power is the torque's and the speed's."""


def series_of(columns: Mapping[str, Floats]) -> dict[str, Series]:
    """A recording as the diagnosis reads it."""
    t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
    return {name: Series(t_ns, values) for name, values in columns.items() if name != "time_s"}


def nominal() -> Model:
    """What the model file knows of every rig here."""
    return _loaded(model_yaml(Drive()))


def read_again(model: Model) -> Model:
    """A model as its file holds it."""
    return _loaded(dump_model(model))


def _loaded(text: str) -> Model:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "model.yaml"
        file.write_text(text, encoding="utf-8")
        return load_model(file)


def run(name: str, plan: Plan) -> dict[str, Any]:
    """One case: what was hidden, what was made of it, and the figures."""
    case, model = make(plan), nominal()
    recordings = {one: series_of(columns) for one, columns in case.recordings.items()}
    kept = {"holdout": recordings.pop("holdout")}
    since = time.perf_counter()
    diagnosis = diagnose(model, recordings, kept)
    took = time.perf_counter() - since
    content, spared = diagnosis.content, series_of(case.spared)
    written = read_again(diagnosis.model)
    oracle = measures([Holdout(prepared("holdout", spared, 0.0, {}), spared)], model, model)
    read = [Holdout(prepared("holdout", kept["holdout"], 0.0, {}), kept["holdout"])]
    before, after = (measures(read, model, one) for one in (model, written))
    excess = before["torque_nrmse"] ** 2 - oracle["torque_nrmse"] ** 2
    lost = before["rack_force_rmse_n"] - oracle["rack_force_rmse_n"]
    models = [one for one in content["findings"] if one.get("model")]
    told = content["findings"][:1]
    return {
        "hidden": name,
        "seed": plan.seed,
        "size": plan.wanted[0][1] if plan.wanted else 0.0,
        "reached": [one["effect_to_noise"] for one in case.answer["effects"]],
        "share": (before["torque_nrmse"] ** 2 - after["torque_nrmse"] ** 2) / excess,
        "force_share": (before["rack_force_rmse_n"] - after["rack_force_rmse_n"]) / lost,
        "force_n": [one["rack_force_rmse_n"] for one in (before, after, oracle)],
        "force_lost": lost / before["rack_force_rmse_n"],
        "free_run": [one["free_run"]["angle_rmse_rad"] for one in (before, after, oracle)],
        "names": [one["effect"] for one in content["findings"] if one["effect"] != "unknown"],
        "where": [place["signal"] for one in models or told for place in one["where"]],
        "terms": [term for one in models for term in one["model"]["terms"]],
        "laws": [one["model"]["law"] for one in models],
        "like": [like["what"] for one in models for like in one["resembles"]],
        "verdict": content["verdict"],
        "seconds": round(took, 1),
    }


def _told(signal: str) -> str:
    return _ANGLE if signal == _PLACE else signal.removeprefix("abs_")


def _signals(term: Mapping[str, Any]) -> set[str]:
    """What a term depends on, the factor that its place brings along included."""
    found = set()
    for name in term["inputs"]:
        stem = name.removeprefix("abs_")
        if "_power_" in stem:
            stem = stem.split("_power_")[0]
            found |= {{"motor": _TORQUE, "load": _FORCE}.get(stem, _SENSOR), _SPEED}
        else:
            found.add(_told(name))
    if term["how"] == "factor":
        found |= {"motor": {_TORQUE}, "load": {_FORCE}, "torsion_bar": {_SENSOR}}.get(
            term["where"], set()
        )
    return found


def right_place(case: Mapping[str, Any]) -> bool:
    """Whether the first place told is one of the signals that the hidden effect depends on."""
    true = {_told(one) for one in TRUE[case["hidden"]].signals}
    return bool(case["where"]) and _told(case["where"][0]) in true


def right_law(case: Mapping[str, Any]) -> bool:
    """Whether it is named, or the largest term has its inputs and its memory."""
    true = TRUE[case["hidden"]]
    if true.name and case["like"][:1] == [true.name]:
        return True
    if not case["terms"] or "values" in case["terms"][0]:
        return False
    first = case["terms"][0]
    ways = {"play": ("play", "stop", "hysteresis"), "hysteresis": ("stop", "hysteresis")}
    memories = [one for one in first["memory"] if one != "none"]
    wanted = ways.get(true.memory, (true.memory,))
    kept = all(one in wanted for one in memories) and bool(memories) == (true.memory != "none")
    signals = {_told(one) for one in true.signals}
    return kept and _signals(first) <= signals and bool(_signals(first) & signals)


def table(cases: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a row for each family, then the figures over all cases."""
    lines = [
        "| hidden | cases | share | lowest | force | run | place | law | s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]

    def row(name: str, these: Sequence[Mapping[str, Any]]) -> str:
        shares = [one["share"] for one in these]
        force = [one["force_share"] for one in these if one["force_lost"] > 0.1]
        place, law = (
            100 * np.mean([true(one) for one in these]) for true in (right_place, right_law)
        )
        told = f"{np.median(force):.2f}" if force else "–"
        runs = [one["free_run"] for one in these]
        run = max((after or np.inf) / (before or np.inf) for before, after, _ in runs)
        took = np.median([one["seconds"] for one in these])
        return (
            f"| {name} | {len(these)} | {np.median(shares):.2f} | {min(shares):.2f} | {told} | "
            f"{run:.2f} | {place:.0f} % | {law:.0f} % | {took:.0f} |"
        )

    hidden = [one for one in cases if not one["hidden"].startswith("decoy")]
    for name in sorted({one["hidden"] for one in hidden}):
        lines.append(row(name, [one for one in hidden if one["hidden"] == name]))
    for what, these in (
        ("**all**", hidden),
        ("written last", [one for one in hidden if one["hidden"] in LATER]),
    ):
        if these:
            lines.append(row(what, these))
    if hidden:
        low = float(np.quantile([one["share"] for one in hidden], 0.1))
        lines += ["", f"Nine of ten cases have a share of {low:.2f} or more."]
    decoys = [one for one in cases if one["hidden"].startswith("decoy")]
    if decoys:
        false = sum(bool(one["terms"]) for one in decoys)
        lines += ["", f"Decoys: {false} of {len(decoys)} with an empirical effect."]
    return "\n".join(lines)


def main(given: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--families", nargs="+", default=sorted(NAMELESS))
    parser.add_argument("--sizes", type=float, nargs="+", default=[3.0], help="effect to noise")
    parser.add_argument("--seeds", type=int, nargs="+", default=[11])
    parser.add_argument("--decoys", type=int, default=0)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args(given)
    cases = []
    if chosen.out and chosen.out.exists():
        cases = [json.loads(line) for line in chosen.out.read_text(encoding="utf-8").splitlines()]
    done = {(one["hidden"], one["seed"], one["size"]) for one in cases}
    wanted = [
        (name, Plan("nameless", seed, ((name, size),)))
        for seed in chosen.seeds
        for size in chosen.sizes
        for name in chosen.families
    ]
    for k in range(chosen.decoys):
        decoy = DECOYS[k % len(DECOYS)]
        wanted.append((f"decoy: {decoy}", Plan("decoys", chosen.seeds[0] + k, (), decoy=decoy)))
    for name, plan in wanted:
        size = plan.wanted[0][1] if plan.wanted else 0.0
        if (name, plan.seed, size) in done:
            continue
        cases.append(run(name, plan))
        if chosen.out:
            with chosen.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(cases[-1]) + "\n")
        one = cases[-1]
        sys.stderr.write(
            f"{name} {size:g} {plan.seed}: {one['share']:.2f}, {one['seconds']:.0f} s, "
            f"{'; '.join(filter(None, one['laws'])) or [t['form'] for t in one['terms']]}\n"
        )
    sys.stdout.write(f"{table(cases)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
