"""What an investigation has done: one log and one ``.json`` a step, one ``.json`` a round.

A step's ``.json`` is written last and whole, a log that is still being written is a ``.part.log``:
killed at any moment, an investigation loses at most the experiment that was running.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil import json_text
from eps_hil.errors import InputError
from eps_hil.investigate.experiment import Experiment, Kind
from eps_hil.physics.model import Model, dump_model
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


class Journal:
    """The folder of one investigation."""

    def __init__(self, folder: Path, model: Model, limits: Limits, simulated: bool) -> None:
        self.folder = folder
        told = dump_model(model) + repr(limits)
        head = {
            "schema": SCHEMA,
            "of": hashlib.sha256(told.encode()).hexdigest(),
            "simulated": simulated,
        }
        file = folder / HEAD
        if file.exists():
            if _read(file) != head:
                problem = "was made with another model file, other limits, or the other kind of rig"
                raise InputError(file, "", problem, "use another folder")
            return
        make_folder(folder, "--out")
        _write(file, head)

    def steps(self) -> list[Step]:
        """All finished steps in their order."""
        found = []
        for path in sorted(self.folder.glob("step_*.json")):
            content = _read(path)
            try:
                given = {**content["experiment"], "kind": Kind(content["experiment"]["kind"])}
                number, rig_s = int(content["number"]), float(content["rig_s"])
                log = self.folder / content["log"]
                found.append(Step(number, Experiment(**given), rig_s, log, content["problem"]))
            except (KeyError, TypeError, ValueError) as error:
                problem = f"is no step of an investigation: {error}"
                raise InputError(path, "", problem, "use another folder") from None
        return found

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
        return [_read(path) for path in sorted(self.folder.glob("round_*.json"))]

    def write_round(self, content: Mapping[str, Any]) -> None:
        """Thought, and decided what comes next."""
        _write(self.folder / f"round_{content['round']:02d}.json", content)


def _read(path: Path) -> dict[str, Any]:
    try:
        return dict(json_text.parse(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise InputError(path, "", f"cannot be read: {error}", "use another folder") from None


def _write(path: Path, content: Mapping[str, Any]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
