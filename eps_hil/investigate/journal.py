"""What an investigation has done: one log and one ``.json`` a step, one ``.json`` a round.

A step's ``.json`` is written last and whole, a log that is still being written is a ``.part.log``:
killed at any moment, an investigation loses at most the experiment that was running.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil.errors import InputError
from eps_hil.investigate.experiment import Experiment, Kind
from eps_hil.physics.model import Model, dump_model
from eps_hil.programme.fingerprint import check_same, read_json
from eps_hil.programme.limits import Limits
from eps_hil.recordings.files import make_folder, replacing

SCHEMA = "eps-hil/investigation/1"
HEAD = "investigation.json"


@dataclass(frozen=True, slots=True)
class Step:
    """An experiment that was run; ``problem``: why its recording is not used, if it is not."""

    number: int
    experiment: Experiment
    rig_s: float
    log: Path
    problem: str = ""


def next_number(steps: Sequence[Step]) -> int:
    """Of the step after these, one of which may be missing: no log is written over."""
    return 1 + max((one.number for one in steps), default=0)


class Journal:
    """The folder of one investigation.

    ``rig``: :func:`~eps_hil.programme.fingerprint.fingerprint` of model, database, mapping, bus,
    and of a simulated rig all that it is.
    """

    def __init__(
        self, folder: Path, model: Model, limits: Limits, simulated: bool, rig: str = ""
    ) -> None:
        self.folder = folder
        told = dump_model(model) + repr(limits)
        head = {
            "schema": SCHEMA,
            "of": hashlib.sha256(told.encode()).hexdigest(),
            "simulated": simulated,
            "rig": rig,
        }
        file = folder / HEAD
        if file.exists():
            other = "with another model file, other limits, or the other kind of rig"
            check_same(file, head, other, "database, mapping, bus or simulated rig")
            return
        make_folder(folder, "--out")
        _write(file, head)

    def steps(self) -> list[Step]:
        """All finished steps in their order."""
        found = []
        for path in self.folder.glob("step_*.json"):
            content = read_json(path)
            try:
                given = {**content["experiment"], "kind": Kind(content["experiment"]["kind"])}
                number, rig_s = int(content["number"]), float(content["rig_s"])
                log = self.folder / content["log"]
                found.append(Step(number, Experiment(**given), rig_s, log, content["problem"]))
            except (KeyError, TypeError, ValueError) as error:
                problem = f"is no step of an investigation: {error}"
                raise InputError(path, "", problem, "use another folder") from None
        return sorted(found, key=lambda one: one.number)

    def log_of(self, number: int, experiment: Experiment) -> Path:
        """Where the step's log goes when it is whole."""
        return self.folder / f"step_{number:02d}_{experiment.name}.log"

    def write_step(self, step: Step) -> None:
        """The step is over."""
        content = {
            "number": step.number,
            "experiment": step.experiment.content(),
            "rig_s": step.rig_s,
            "log": step.log.name,
            "problem": step.problem,
        }
        _write(self.folder / f"step_{step.number:02d}.json", content)

    def rounds(self) -> list[dict[str, Any]]:
        """What was thought after each step, in order; the first before any."""
        found = [read_json(path) for path in self.folder.glob("round_*.json")]
        return sorted(found, key=lambda one: int(one["round"]))

    def write_round(self, content: Mapping[str, Any]) -> None:
        """Thought, and decided what comes next."""
        _write(self.folder / f"round_{content['round']:02d}.json", content)


def _write(path: Path, content: Mapping[str, Any]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
