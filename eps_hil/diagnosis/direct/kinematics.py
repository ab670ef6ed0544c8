"""The second residual: where the rotor is against where the rack is, and what the twist says.

    e = φ − i_APA · x           (rad at the rotor; zero for a rigid drive; ``rotor_and_rack.py``)
    u = ψ_wheel − i_pi · x      (rad at the column; the torsion bar's twist; ``torsion_bar.py``)

Play between rotor and rack, a belt that gives, a ratio that changes with x and play in the torque
sensor show here directly; in the torque balance they look like noise.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.excerpt import evenly
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.direct.rotor_and_rack import (
    JOINTS,
    LEAST_RATIO,
    SEPARATE,
    Rows,
    has_rack,
    may_be_open,
    rotor_against_rack,
    rubs_behind,
    transmitted,
)
from eps_hil.diagnosis.direct.seen import Seen
from eps_hil.diagnosis.direct.separation import Separation, separation, shown
from eps_hil.diagnosis.direct.torsion_bar import (
    PLAY,
    Law,
    has_twist,
    sensor_play,
    torque_of_twist,
    twist_noise,
)
from eps_hil.diagnosis.mismatch.leftover import BESIDE_UNKNOWN
from eps_hil.physics.model import Model

Flags = npt.NDArray[np.bool_]

_TOLD_RATIO = 1e-3
"""How far a ratio is off to be worth a sentence where it is no finding."""
_MORE_THAN_NOISE = 1.5
"""Times the sensors' noise that a residual is not explained."""
_FEWEST = 500
"""Samples (of 8 ms) with the joint under load that a recording needs to say anything: 4 s."""


@dataclass(frozen=True)
class Kinematics:
    """What the second residual shows; ``content`` is for the JSON, empty where there is none.

    ``coefficients``: of the whole fit, by column name. ``twist`` turns the bar's
    twist into torque, where play in the sensor was found.
    """

    seen: tuple[Seen, ...] = ()
    content: dict[str, Any] = field(default_factory=dict)
    twist: Law | None = None
    gap_rad: float = 0.0
    left: Separation | None = None
    """What of rotor against rack no name stands for."""
    behind: bool = False
    """Whether friction acts on the rack, behind what gives or is loose."""

    def corrected(self, one: Prepared, model: Model) -> Prepared:
        """The recording with the torsion-bar torque that the twist shows in place of the report."""
        if self.twist is None or not has_twist(one):
            return one
        true = torque_of_twist(one, model, self.twist)
        late = model.delays_s.of("torque_sensor_nm")
        raw = {**one.raw, "torque_sensor_nm": np.interp(one.time_s - late, one.time_s, true)}
        sigma = self.twist.gain * twist_noise(one, model)
        return one.changed(raw=raw, noise={**one.noise, "torque_sensor_nm": sigma})

    def put_right(self, one: Prepared, model: Model) -> Prepared:
        """As :meth:`corrected`, with the samples barred at which the drive is in two pieces."""
        loose = self.loose(one, model)
        right = self.corrected(one, model)
        return right.changed(barred=loose if one.barred is None else one.barred | loose)

    def loose(self, one: Prepared, model: Model) -> Flags:
        """Thinned samples at which the gap is open and the drive in two pieces, shape (m,)."""
        n = len(one.thin_time_s)
        if self.gap_rad == 0.0 or "rack_position_m" not in one.raw:
            return np.zeros(n, dtype=bool)
        return may_be_open(one.thin(transmitted(one, model, behind=self.behind)), one)


def _beside(left: Separation, found: Sequence[Seen]) -> list[Seen]:
    """Names that may stand beside something unknown; those of its kind only if they do better."""
    kept = [one for one in found if one.gain > BESIDE_UNKNOWN * left.energy]
    return [one for one in kept if not left.alone or one.entry["effect"] not in JOINTS]


def shows(recordings: Iterable[Prepared], model: Model) -> frozenset[str]:
    """Effects (ids) that rotor, rack and steering wheel show, where all recordings have them."""
    every = list(recordings)
    of_rack = SEPARATE if all(has_rack(one, model) for one in every) else ()
    of_twist = (PLAY,) if all(map(has_twist, every)) else ()
    return frozenset((*of_rack, *of_twist))


def examine(
    fitted: Sequence[Prepared],
    judged: Sequence[Prepared],
    model: Model,
    without: Collection[str] = (),
) -> Kinematics:
    """Look at rotor against rack, and at the twist, of all recordings that hold them.

    An effect is seen only if it also lowers the same residual of the ``judged`` recordings, and
    if its id is not in ``without``.
    """
    learnt, kept = ([one for one in some if has_rack(one, model)] for some in (fitted, judged))
    apart = _apart(learnt, kept, model, without, behind=False)
    if apart.more_than_noise and rubs_behind(learnt, model):
        other = _apart(learnt, kept, model, without, behind=True)
        apart = other if other.joint else apart
    seen, twist = apart.seen, None
    play = sensor_play(evenly(fitted), judged, model)
    if play is not None and play[0].entry["effect"] not in without:
        seen.append(play[0])
        twist = play[1]
    return Kinematics(tuple(seen), apart.content, twist, apart.gap_rad, apart.left, apart.behind)


@dataclass(frozen=True)
class _Apart:
    """What rotor against rack shows, with friction on the rotor or ``behind``."""

    seen: list[Seen] = field(default_factory=list)
    content: dict[str, Any] = field(default_factory=dict)
    left: Separation | None = None
    gap_rad: float = 0.0
    behind: bool = False

    @property
    def joint(self) -> bool:
        """Whether something gives or is loose."""
        return any(one.entry["effect"] in JOINTS for one in self.seen)

    @property
    def more_than_noise(self) -> bool:
        """Whether rotor and rack come apart at all, named or not."""
        if not self.content:
            return False
        much = self.content["rms_left_rad"] > _MORE_THAN_NOISE * self.content["noise_rad"]
        return much or self.joint or self.left is not None


def _apart(
    fitted: Sequence[Prepared],
    judged: Sequence[Prepared],
    model: Model,
    without: Collection[str],
    *,
    behind: bool,
) -> _Apart:

    def rows_of(recordings: Sequence[Prepared]) -> list[Rows]:
        rows = each(lambda one: Rows(one, model, behind=behind), recordings)
        return [one for one in rows if len(one.e) >= _FEWEST]

    rows, kept = rows_of(fitted), rows_of(judged)
    if not rows:
        return _Apart()
    found, content, accepted = rotor_against_rack(rows, kept, without)
    left = separation(rows, accepted, without)
    left = left if left is None or shown(left, kept, accepted) else None
    if behind:
        content["friction_acts_on"] = "rack"
    gap = next((one.entry["gap_rad"] for one in found if one.entry["effect"] == "backlash"), 0.0)
    seen = list(found) if left is None else _beside(left, found)
    return _Apart(seen, content, left, gap, behind)


def where_friction_acts(content: Mapping[str, Any]) -> list[str]:
    """A sentence where it does not act where a model file has it."""
    if content.get("kinematics", {}).get("friction_acts_on") != "rack":
        return []
    return [
        "Friction acts on the rack, behind the joint that was found, and not on the rotor, where "
        "a model file has it: while the joint is loose or gives, the two differ."
    ]


def small_ratio(content: Mapping[str, Any]) -> list[str]:
    """A sentence where the ratio is clearly off by too little to be a finding."""
    off = content.get("kinematics", {}).get("ratio_error", 0.0)
    if not _TOLD_RATIO <= abs(off) <= LEAST_RATIO:
        return []
    if any(one["effect"] == "rack_ratio" for one in content["findings"]):
        return []
    return [
        f"The ratio from rack to rotor is {off:+.2%} off: up to {LEAST_RATIO:.1%} is how drives "
        "and model files are, and no finding."
    ]
