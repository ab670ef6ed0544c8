"""Fig. 5: frequency responses to the motor torque: the rig against 1- to 5-mass chains."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from eps_hil.identification.chain_response import (
    Agreement,
    Load,
    agreement,
    chain_responses,
)
from eps_hil.identification.frequency_response import (
    OUTPUTS,
    ResponseSettings,
    Stretch,
    responses,
    stretches,
)
from eps_hil.report import frequency_figure
from eps_hil.reproduction.result import Result, Table, at_least, at_most
from eps_hil.reproduction.workbench import Workbench, series
from eps_hil.rig.manoeuvre import Manoeuvre
from eps_hil.rig.offline import simulate_recording

_ORDERS = (1, 2, 3, 4)


def make(bench: Workbench, folder: Path) -> Result:
    """Multisines of several phases, and the paper's sweep, on the rig and through each chain."""
    rig = bench.manoeuvre("multisine").segments[0].rig
    settings = ResponseSettings(resolution_hz=0.5 if bench.quick else 0.25)
    load = Load(rig.stiffness_n_per_m, rig.damping_n_s_per_m)
    parts = [
        part
        for k in range(1 if bench.quick else 3)
        for part in _recorded(bench, bench.manoeuvre("multisine"), k)
    ]
    measured = responses(parts, settings)
    chains = chain_responses(parts, bench.identified, bench.chain, load, settings, _ORDERS)
    found = [agreement(measured[name], chains[k][name], k) for k in _ORDERS for name in OUTPUTS]
    swept = _recorded(bench, bench.manoeuvre("torque_sweep"), 0)
    sweep = responses(swept, settings)
    swept_chains = chain_responses(swept, bench.identified, bench.chain, load, settings, _ORDERS)
    rows = [agreement(sweep[name], swept_chains[k][name], k) for k in _ORDERS for name in OUTPUTS]
    against = {name: agreement(measured[name], sweep[name], 0).gain_error for name in OUTPUTS}
    picture = frequency_figure.draw(measured, chains, folder / "fig5.png")
    return Result(
        "fig5",
        "Fig. 5: frequency responses of the rig and of the 1- to 4-mass models",
        f"{len(parts)} multisines of the motor torque, 0.5 to 8 Hz, 0.4 Nm rms (their coherence "
        "and band mean something), and the paper's sine sweep; the linear motor "
        f"is a spring-damper ({rig.stiffness_n_per_m / 1e3:g} kN/m, "
        f"{rig.damping_n_s_per_m / 1e3:g} kNs/m). The rig has five masses; the same "
        "torques run through each chain, friction included, and all signals through the same H1 "
        "estimator.",
        [
            _table(found, "models against the rig, multisine, rms over 0.5 to 8 Hz"),
            _table(rows, "models against the rig, the paper's sine sweep (3 Nm), same band"),
            Table(
                "the rig's own response, sweep against multisine: friction makes it depend on both",
                ("output", "rms difference, relative"),
                tuple((OUTPUTS[name], value) for name, value in against.items()),
            ),
        ],
        [
            at_most(
                "all models (1 to 4 masses) approximate the rig well in the range of interest",
                "largest rms error of a response, relative, 0.5 to 8 Hz",
                _worst(found, _ORDERS), "", (0.1, 0.25),
                "the single mass has no torsion bar: the steering wheel cannot hold the rotor "
                "still near 8.5 Hz, nor swing at 10 Hz",
            ),
            at_most(
                "the 2- to 4-mass models approximate the rig well",
                "largest rms error of a response, relative, 0.5 to 8 Hz",
                _worst(found, (2, 3, 4)), "", (0.1, 0.25),
                "rack force is worst: the tie rods in series with the linear motor's damper are "
                "in none of them",
            ),
            at_least(
                "the responses are measured well enough to tell (ours: the paper shows no "
                "coherence)",
                "smallest coherence over all outputs and lines",
                min(float(np.min(one.coherence)) for one in measured.values()), "", (0.8, 0.5),
            ),
        ],
        picture,
    )  # fmt: skip


def _worst(found: list[Agreement], orders: tuple[int, ...]) -> float:
    return max(one.gain_error for one in found if one.order in orders)


def _recorded(bench: Workbench, manoeuvre: Manoeuvre, k: int) -> list[Stretch]:
    """What the rig records, with phases and noise of the k-th time."""
    one = replace(manoeuvre, seed=manoeuvre.seed + k)
    made = simulate_recording(bench.model, bench.chain, one, seed=bench.seed + 50 + k)
    return stretches(series(made.columns), bench.model)


def _table(found: list[Agreement], title: str) -> Table:
    columns = (
        "masses", "output", "rms error, relative", "magnitude in dB", "phase in deg",
        "share within the 95 % band",
    )  # fmt: skip
    rows = tuple(
        (f"{one.order}", OUTPUTS[one.output], one.gain_error, one.magnitude_error_db,
         one.phase_error_deg, one.inside)
        for one in found
    )  # fmt: skip
    return Table(title, columns, rows)
