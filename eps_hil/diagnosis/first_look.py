"""What is settled before the torque balance: data quality, speed and angle, rotor against rack.

Each of these would come back from the torque balance under a wrong name. So bad stretches are
barred, a drifting clock is set right, a torque sensor with play is replaced by the torsion bar's
twist, and a wrong ratio goes into the model, before any friction is looked at.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from eps_hil.diagnosis.balance.excerpt import evenly
from eps_hil.diagnosis.data import quality
from eps_hil.diagnosis.data.drift import Drift
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.direct import already, kinematics
from eps_hil.diagnosis.direct.belt import Belt, belt_in, belt_of, usual_belt, with_belt
from eps_hil.diagnosis.direct.reversals import Bristle
from eps_hil.diagnosis.direct.seen import finding
from eps_hil.diagnosis.direct.separation import Separation
from eps_hil.diagnosis.direct.speed_and_angle import speed_and_angle
from eps_hil.diagnosis.direct.speed_scale import speed_scale
from eps_hil.diagnosis.direct.zero_reading import ZeroReadings, zero_readings
from eps_hil.physics.model import Model
from eps_hil.series import Series

Signals = Mapping[str, Series]

_DRIFT, _ROUNDS = "clock_drift", 4
_PUT_RIGHT = (_DRIFT, "torque_sensor_hysteresis", "belt_compliance")
"""Effects that are taken out of the recordings, not (or not only) put into the model."""


@dataclass(frozen=True)
class FirstLook:
    """The recordings put right, and the model with what is known of the drive by now.

    ``findings`` are JSON entries (CONTRACT 7), ``entries`` those of a model file; ``data_quality``
    and ``kinematics`` go into the JSON under keys of their own.
    """

    fitted: Sequence[Prepared]
    kept: Sequence[Prepared]
    model: Model
    findings: tuple[dict[str, Any], ...]
    entries: tuple[dict[str, Any], ...]
    data_quality: tuple[dict[str, Any], ...]
    kinematics: Mapping[str, Any]
    kept_quality: tuple[quality.Quality, ...] = ()
    """Of each recording in ``kept``, where its data are bad."""
    left: Separation | None = None
    """What of rotor against rack no name stands for."""
    zero: ZeroReadings = field(default_factory=ZeroReadings)
    """What the torque sensors read with nothing on them; ``model`` has the errors among it."""
    remarks: tuple[str, ...] = ()
    """What a reader has to know of speed and angle, which have been put right in it."""
    notes: tuple[str, ...] = ()
    """What a reader has to know of both that was left as recorded."""
    shown: frozenset[str] = frozenset()
    """Effects (ids) that signals of the motion show between them, whatever the load is. A delay is
    none: what speed and angle have in common only torques tell."""

    @property
    def put_right(self) -> bool:
        """Whether the recordings hold something else now than what was read."""
        return bool(self.remarks) or any(one["effect"] in _PUT_RIGHT for one in self.findings)

    @property
    def put_right_in_no_file(self) -> bool:
        """Whether that is so in a way that no model file holds: a clock's, a smoothed speed's."""
        return bool(self.remarks) or any(one["effect"] == _DRIFT for one in self.findings)

    @property
    def ratio_is_measured(self) -> bool:
        """Whether rotor against rack has shown what the ratio is."""
        return "ratio_error" in self.kinematics

    def added_to(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """The JSON with this look's findings and keys; names found twice stand once."""
        named = {one["effect"] for one in content["findings"]}
        new = [one for one in self.findings if one["effect"] not in named]
        known = [one for one in content["findings"] if one["effect"] != "unknown"]
        unknown = [one for one in content["findings"] if one["effect"] == "unknown"]
        if self.left is not None:
            unknown.append(self.left.finding())
        verdict = content["verdict"]
        if new or self.left is not None:
            verdict = "partly_explained" if unknown else "explained"
            verdict = verdict if known or new else "unknown_effect"
        return {
            **content,
            "verdict": verdict,
            "findings": [*known, *new, *unknown],
            "data_quality": list(self.data_quality),
            "kinematics": dict(self.kinematics),
        }

    def with_signal(self, put_right: Callable[[Prepared], Prepared], model: Model) -> "FirstLook":
        """The same with a signal put right in every recording, and the model that goes with it."""
        fitted, kept = ([put_right(one) for one in some] for some in (self.fitted, self.kept))
        return replace(self, fitted=fitted, kept=kept, model=model)

    def with_zero(self, zero: ZeroReadings) -> "FirstLook":
        """The same with other readings of sensors that have nothing on them."""
        names = {one.effect for one in self.zero.clear}
        entries = [one.entry for one in self.zero.clear]
        effects = tuple(one for one in self.model.effects if one not in entries)
        others = tuple(one for one in self.findings if one["effect"] not in names)
        return replace(
            self,
            model=zero.in_model(replace(self.model, effects=effects)),
            findings=(*others, *(one.finding() for one in zero.clear)),
            zero=zero,
        )

    def with_bristle(self, seen: Bristle) -> "FirstLook":
        """The same with the stiffness that full reversals showed."""
        effects = (*self.model.effects, seen.entry)
        return replace(
            self,
            model=replace(self.model, effects=effects),
            findings=(*self.findings, seen.finding()),
        )

    def in_model(self, model: Model) -> Model:
        """A model file's model with this look's effects that it does not hold yet."""
        held = {entry["effect"] for entry in model.effects}
        new = tuple(entry for entry in self.entries if entry["effect"] not in held)
        return replace(model, effects=(*model.effects, *new))


def _on_one_clock(
    ready: Sequence[Prepared], fitted: int, model: Model, without: Collection[str]
) -> tuple[list[Prepared], kinematics.Kinematics, Drift | None]:
    """Rotor against rack once the motion's clock is set right, and by how much it drifted.

    A delay that has grown to many milliseconds is more than the speed times itself, so what is
    left of it is looked for again.
    """
    ready, total = list(ready), None
    for _ in range(_ROUNDS):
        seen = kinematics.examine(ready[:fitted], ready[fitted:], model, without)
        drifts = [one for one in seen.seen if one.entry["effect"] == _DRIFT]
        if not drifts:
            break
        (one,) = drifts
        more = Drift(one.entry["ppm"], one.half_width["ppm"], one.gain)
        ready = [more.corrected(recording) for recording in ready]
        total = more if total is None else replace(more, ppm=total.ppm + more.ppm, gain=total.gain)
    others = tuple(one for one in seen.seen if one.entry["effect"] != _DRIFT)
    return ready, replace(seen, seen=others), total


def _with_belt(
    ready: list[Prepared], fitted: int, model: Model, stiffness_nm_per_rad: float, *, known: bool
) -> tuple[list[Prepared], Belt]:
    """The recordings with what such a belt does to the balance, where that matters; the belt.

    ``known``: whether the load is, without which the balance says nothing of it.
    """
    belt = None
    if known and "rack_force_n" in ready[0].raw:
        belt = belt_of(evenly(ready[:fitted]), model, stiffness_nm_per_rad)
    if belt is None:
        return ready, usual_belt(model, stiffness_nm_per_rad)
    return [with_belt(one, model, belt) for one in ready], belt


def first_look(
    fitted: Sequence[tuple[Prepared, Signals]],
    kept: Sequence[tuple[Prepared, Signals]],
    model: Model,
    without: Collection[str] = (),
    hidden: Collection[str] = (),
) -> FirstLook:
    """Look at recordings, each prepared and as it was read; those ``kept`` are the hold-outs.

    Effects in ``without`` (ids) are not considered. Of those ``hidden`` by a load that nobody
    measured the forces say nothing, but two signals of the motion do.
    """
    ratio = model.rack_to_rotor_ratio_rad_per_m
    looks = each(
        lambda given: quality.look_at(given[0].name, given[1], ratio, given[0].size.angle),
        (*fitted, *kept),
    )
    ready = [
        one.changed(barred=look.barred(one))
        for look, (one, _) in zip(looks, (*fitted, *kept), strict=True)
    ]
    n, barred = len(fitted), [one.barred for one in ready]
    findings: list[dict[str, Any]] = []
    entries: list[dict[str, Any]] = []
    lost = quality.finding(looks)
    if lost is not None and "dropped_frames" not in without:
        findings.append(lost)
    scale = speed_scale(ready)
    apart = speed_and_angle(evenly(ready[:n]), model, without)
    remarks = [] if apart is None else apart.remarks()
    notes: list[str] = []
    if apart is not None:
        ready, model = [apart.put_right(one) for one in ready], apart.in_model(model)
        findings += apart.findings()
    ready, seen, drifting = _on_one_clock(ready, n, model, without)
    if drifting is not None:
        findings = [one for one in findings if one["effect"] != _DRIFT]  # one clock, one finding
        findings.append(drifting.finding())
    if scale is not None:
        ready, more, notes = scale.told(ready, seen.content)
        remarks += more
    ready = [seen.put_right(one, model) for one in ready]
    given = model
    for effect in seen.seen:  # the balance has of them what is put right, once
        model = already.without(model, effect)
    for effect in seen.seen:
        name = effect.entry["effect"]
        held = already.held(given, effect, ready[0].size)
        findings += [] if held else [finding(effect)]
        if name == "rack_ratio":
            model = replace(model, effects=(*model.effects, effect.entry))
            continue
        entries.append(held or dict(effect.entry))
        if name == "belt_compliance":
            stiffness = effect.entry["stiffness_nm_per_rad"]
            ready, belt = _with_belt(ready, n, model, stiffness, known=name not in hidden)
            if held is None:
                damping = float(f"{belt.damping_nm_s_per_rad:.3g}")
                entries[-1]["damping_nm_s_per_rad"] = damping
                findings[-1] = belt.told(findings[-1])
    unseen = belt_in(model)  # by a model that holds one, where nothing measured it
    if unseen is not None:
        ready = [with_belt(one, model, unseen) for one in ready]
    # an open gap bars the balance, not a sensor
    whole = [one.changed(barred=bad) for one, bad in zip(ready, barred, strict=True)]
    play = [one for one in seen.seen if one.entry["effect"] == "torque_sensor_hysteresis"]
    unsure = play[0].half_width["play_nm"] if play else 0.0
    zero = zero_readings(whole, model, {*without, *hidden}, unsure)
    findings += [one.finding() for one in zero.clear]
    return FirstLook(
        ready[:n],
        ready[n:],
        zero.in_model(model),
        tuple(findings),
        tuple(entries),
        tuple(look.content() for look in looks),
        seen.content,
        tuple(looks[n:]),
        seen.left,
        zero,
        tuple(remarks),
        (*notes, *quality.remarks(looks)),
        kinematics.shows(ready, model),
    )
