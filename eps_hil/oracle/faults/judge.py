"""Was any published estimate wrong and called valid, and was the service back in time?

Wrong: more than 100 N from what the fault-free run published of the same physical instant. The
instant is what a receiver makes of a frame: when it came, less the age that it carries; so an age
that is too small counts against the estimate. Wrong frames less than 20 ms apart are one spell;
a spell of more than 20 ms is a failure.

Back: 2 s after the last fault's end the estimate must be valid and stay it. One thing may take
longer. Whoever did not see how far the rotor turned cannot know how the bristles of a resting
contact are bent; +-300 N hang on it. So a rotor that did turn during the faults (or whose angle
nobody can compare, after a restart of the service, say) and stands still since then gives no
estimate until it has slid, and only that is waited for, as long as the stretch goes on.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.validity import Reason, words
from eps_hil.oracle.faults.scene import Scene
from eps_hil.oracle.faults.stretch import MS
from eps_hil.oracle.faults.traffic import T0_NS, VALID, Published

WRONG_N = 100.0
SPELL_NS = 20 * MS
BACK_NS = 2_000 * MS
SLID_RAD = 0.3
"""Way in one direction after which nothing is left of an unknown bend; some six times the bend
at break-away of the reference rig."""
SLID_GRACE_NS = 500 * MS
STILL_RAD = 0.004
MAX_AGE_MS = 127.0

Int64 = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]


@dataclass(slots=True)
class Outcome:
    """One case. ``back_ms``: from the last fault's end until valid for good; None: not asked.

    ``wrong``: what broke the rules, in words; empty where nothing did.
    """

    seed: int
    kinds: tuple[str, ...]
    worst_n: float = 0.0
    longest_ms: float = 0.0
    back_ms: float | None = None
    valid_share: float = 0.0
    wrong: list[str] = field(default_factory=list)
    story: list[str] = field(default_factory=list)


def truth(scene: Scene, at: Int64) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """(n,) fault-free estimate (N) of true instants ``at``, and where it was valid itself."""
    force, valid = np.zeros(len(at)), np.zeros(len(at), bool)
    spans = [*scene.stretch.world, (1 << 62, "", 0)]
    for k, (since, name, shift) in enumerate(spans[:-1]):
        here = (at >= since if k else np.ones(len(at), bool)) & (at < spans[k + 1][0])
        if not here.any():
            continue
        recording = scene.world.recordings[name]
        local = at[here] - shift
        force[here] = np.interp(local, recording.instants, recording.force_n)
        near = np.clip(np.searchsorted(recording.instants, local), 1, len(recording.valid) - 1)
        valid[here] = recording.valid[near] & recording.valid[near - 1]
    return force, valid


def errors(scene: Scene, sent: list[Published]) -> Floats:
    """(n,) published minus fault-free (N) where both are valid; NaN elsewhere."""
    at = np.array([each.instant for each in sent], np.int64)
    force, known = truth(scene, at)
    said = np.array([each.status == VALID for each in sent])
    found = np.array([each.force_n for each in sent]) - force
    found[~(said & known)] = np.nan
    return found


def judge(scene: Scene, seed: int, sent: list[Published], until: int) -> Outcome:
    """The verdict over everything published up to true time ``until``."""
    outcome = Outcome(seed, tuple(each.kind for each in scene.done))
    if not sent:
        outcome.wrong.append("nothing was published")
        return outcome
    off = errors(scene, sent)
    too_old = np.array([e.status == VALID and e.age_ms >= MAX_AGE_MS for e in sent])
    bad = (np.abs(off) > WRONG_N) | too_old
    outcome.worst_n = float(np.nanmax(np.abs(off), initial=0.0)) if len(off) else 0.0
    outcome.valid_share = float(np.mean([each.status == VALID for each in sent]))
    spell, first = _longest(np.array([each.at for each in sent], np.int64)[bad])
    outcome.longest_ms = spell / MS
    if spell > SPELL_NS:
        outcome.wrong.append(
            f"valid and up to {outcome.worst_n:.0f} N off for {spell / MS:.0f} ms "
            f"from {(first - scene.stretch.start) / MS:.0f} ms on"
        )
    if not all(each.good for each in sent):
        outcome.wrong.append("a published frame has a wrong CRC")
    _back(scene, sent, until, outcome)
    outcome.story = story(scene, sent, off)
    return outcome


def _longest(at: Int64) -> tuple[int, int]:
    """Longest spell (ns) of wrong frames, less than 20 ms apart, and when it began."""
    if not len(at):
        return 0, 0
    cuts = np.flatnonzero(np.diff(at) > SPELL_NS)
    first = at[np.concatenate(([0], cuts + 1))]
    last = at[np.concatenate((cuts, [len(at) - 1]))]
    k = int(np.argmax(last - first))
    return int(last[k] - first[k]) + MS, int(first[k])


def _back(scene: Scene, sent: list[Published], until: int, outcome: Outcome) -> None:
    end = fault_end(scene)
    asked = asked_from(scene)
    at = np.array([each.at for each in sent], np.int64)
    _, known = truth(scene, np.array([each.instant for each in sent], np.int64))
    good = np.array([each.status == VALID for each in sent]) | ~known
    later = at > end
    missing = at[later & ~good]
    if asked is None:
        return
    last = int(missing[-1]) if len(missing) else end
    silent = not later.any() or until - int(at[-1]) > 50 * MS
    if silent and until >= asked:
        outcome.wrong.append("nothing is published any more")
    elif last > asked:
        left = [each for each in sent if each.at == last][-1]
        outcome.wrong.append(
            f"not valid {(last - end) / MS:.0f} ms after the end: {words(Reason(left.reason))}"
        )
    outcome.back_ms = (last - end) / MS


def fault_end(scene: Scene) -> int:
    """When the last fault was over (true ns); a rig that was stopped may begin anew later."""
    over = max((each.until for each in scene.done), default=scene.stretch.start)
    return max(over, scene.stretch.world[-1][0])


def asked_from(scene: Scene) -> int | None:
    """From when on (true ns) the estimate must be valid; None where that cannot be asked."""
    end = fault_end(scene)
    first = min((each.since for each in scene.done), default=end)
    angle = _angle(scene, first, end + BACK_NS)
    still = float(np.ptp(angle)) < STILL_RAD if len(angle) else True
    if still and not scene.stretch.angle_lost:
        return end + BACK_NS
    slid = _slid_at(scene, end, scene.stretch.end)
    if slid is None:
        return None
    asked = max(end + BACK_NS, slid + SLID_GRACE_NS)
    return asked if asked < scene.stretch.end else None


def _angle(scene: Scene, since: int, until: int) -> Floats:
    """The rotor's angle each ms, as it truly was; restarts of the rig make steps in it."""
    at = np.arange(since, until, MS)
    angle = np.zeros(len(at))
    for k, (from_ns, name, shift) in enumerate(scene.stretch.world):
        here = at >= from_ns if k else np.ones(len(at), bool)
        recording = scene.world.recordings[name]
        place = np.minimum((at[here] - shift - T0_NS) // MS, recording.length_ms - 1)
        angle[here] = recording.angle_rad[place]
    return angle


def _slid_at(scene: Scene, since: int, until: int) -> int | None:
    """When the rotor has turned far enough one way since ``since``."""
    angle = _angle(scene, since, until)
    up = angle - np.minimum.accumulate(angle)
    down = np.maximum.accumulate(angle) - angle
    slid = np.flatnonzero((up > SLID_RAD) | (down > SLID_RAD))
    return since + int(slid[0]) * MS if len(slid) else None


def story(scene: Scene, sent: list[Published], off: Floats) -> list[str]:
    """What happened, line by line, times in ms from the stretch's start."""
    start = scene.stretch.start
    name, local = scene.stretch.truth_of(start)
    lines = [f"manoeuvre {name} from {(local - T0_NS) / 1e9:.1f} s on"]
    events = [(d.since, f"fault  {d.kind}: {d.words}; until {(d.until - start) / MS:.1f}")
              for d in scene.done]  # fmt: skip
    before: tuple[int, int] | None = None
    for k, each in enumerate(sent):
        now = (each.status, each.reason)
        if now != before:
            said = "valid" if each.status == VALID else words(Reason(each.reason))
            what = f"says   {said} ({each.force_n:.0f} N, age {each.age_ms} ms)"
            events.append((each.at, what))
            before = now
        if abs(off[k]) > WRONG_N and (k == 0 or not abs(off[k - 1]) > WRONG_N):
            events.append((each.at, f"wrong  {off[k]:+.0f} N"))
        elif k and abs(off[k - 1]) > WRONG_N and not abs(off[k]) > WRONG_N:
            peak = _peak(off, k - 1)
            events.append((each.at, f"right again or not valid; it was up to {peak:.0f} N"))
    events.append((fault_end(scene), "end of the last fault"))
    asked = asked_from(scene)
    if asked is not None:
        events.append((asked, "from here on it must be valid"))
    events.sort(key=lambda event: event[0])
    return lines + [f"{(at - start) / MS:9.1f} ms  {what}" for at, what in events]


def _peak(off: Floats, k: int) -> float:
    worst = 0.0
    while k >= 0 and abs(off[k]) > WRONG_N:
        worst, k = max(worst, abs(off[k])), k - 1
    return worst
