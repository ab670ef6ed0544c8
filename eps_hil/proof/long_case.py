"""Twenty minutes of recordings of one rig: how long does a diagnosis of all of it take?"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from eps_hil.proof.effects import find
from eps_hil.proof.examine import MODEL, Diagnoser
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.programmes import programme
from eps_hil.proof.sensors import measured, reported
from eps_hil.proof.truth import Drive
from eps_hil.proof.world import World
from eps_hil.proof.write import write_csv

MINUTES = 20.0


def seconds_to_diagnose(seed: int, minutes: float = MINUTES) -> float | None:
    """Wall-clock seconds of one ``eps-hil diagnose``, start and reading included; no page.

    The rig has a Stribeck effect of 0.03 Nm; recordings of 40 and 45 s until ``minutes`` are full.
    None where the diagnosis failed.
    """
    rng = np.random.default_rng([seed, 20])
    world = find("stribeck").apply(World(False), 0.03, {"speed_rad_s": 10.0})
    with TemporaryDirectory() as folder:
        case, results = Path(folder) / "long", Path(folder) / "results"
        case.mkdir()
        results.mkdir()
        (case / MODEL).write_text(model_yaml(Drive()))
        filled, number = 0.0, 0
        while filled < 60.0 * minutes:
            *train, last = programme("training", rng)
            for one in train:
                number += 1
                columns = measured(
                    reported(world.run(one), world.instruments), world.instruments, rng
                )
                write_csv(case / f"train_{number:02d}.csv", columns)
                filled += len(one) * 1e-3
        columns = measured(reported(world.run(last), world.instruments), world.instruments, rng)
        write_csv(case / "holdout.csv", columns)
        with Diagnoser() as diagnoser:
            done = diagnoser.diagnose(case, results, page=False)
    return None if done.problem else done.seconds
