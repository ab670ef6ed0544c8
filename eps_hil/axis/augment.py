"""Baseline and missing physics of the axis together, from the free recording alone.

What finds them is the diagnosis that anybody runs (``eps-hil diagnose`` on the recording as a
table, with a rack force of zero where nothing pushes), with no step of its own.
"""

from dataclasses import dataclass

from eps_hil.axis.emps import AxisRecord
from eps_hil.axis.identify import identify
from eps_hil.diagnosis.attribute.select import Say
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model

__all__ = ["Augmented", "Say", "augment"]


@dataclass(frozen=True)
class Augmented:
    """The published structure with its numbers identified, and what the diagnosis wrote."""

    identified: Model
    diagnosis: Diagnosis

    @property
    def model(self) -> Model:
        """The model that the diagnosis writes."""
        return self.diagnosis.model


def augment(record: AxisRecord, published: Model, say: Say | None = None) -> Augmented:
    """Diagnose the free recording, of which the last third judges what the rest shows."""
    shown = record.series(free_of_load=True)
    told = diagnose(published, {record.name: shown}, {}, say)
    return Augmented(identify(prepare(record.name, shown), published), told)
