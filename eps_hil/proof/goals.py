"""The table of the proof: each figure with its interval beside its goal, met or missed.

Figures are counted on the full truth plant. Shares have Wilson's 95 % interval, medians and pooled
ratios a bootstrap over cases (a fixed seed, so that the same cases give the same interval).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eps_hil.proof.judge import Estimate, Judgement
from eps_hil.proof.score import Share
from eps_hil.proof.truth import Floats

_RESAMPLES = 2000
_LONG = "20 min of recordings diagnosed, seconds on this machine"
NO_GOAL = "–"
CONSTANTS = {"friction_asymmetry", "motor_torque_offset", "torque_sensor_offset"}
"""One constant while sliding, on the full plant at rest too: which one comes first is luck."""
_CLOSE, _LESS_CLOSE = 0.10, 0.15
"""How far off a parameter may be; the larger for Stribeck, dwell and delays."""
_AS_GOOD = 1.15
"""Of the true model's residual: a hold-out that is explained."""
_LEAST_GAIN = 0.05
"""The single case's share of the gain counts where the true model lowers the error by this much."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One row. ``low`` and ``high`` bound the 95 % interval; ``met`` is None without cases."""

    what: str
    value: float | None
    low: float | None
    high: float | None
    cases: int
    goal: str
    met: bool | None
    percent: bool = True

    @property
    def text(self) -> str:
        """The value with its interval."""
        if self.value is None:
            return "–"
        if self.low is None or self.high is None:
            return f"{self.value:.1f}"
        if self.percent:
            return f"{self.value:.1%} ({self.low:.1%} to {self.high:.1%})"
        return f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f})"

    @property
    def verdict(self) -> str:
        """The goal's fate in a word; empty for a row that has no goal."""
        if self.goal == NO_GOAL and self.cases:
            return ""
        return {None: "no cases", True: "met", False: "MISSED"}[self.met]


@dataclass(frozen=True, slots=True)
class Scored:
    """One case with its judgement and what the models were worth on its hold-out."""

    judged: Judgement
    worth: Mapping[str, Mapping[str, float | None]]


Hit = Callable[[Judgement], bool]


def figures(cases: Sequence[Scored], long_s: float | None = None) -> list[Figure]:
    """The rows of the proof; ``long_s``: seconds that 20 minutes of recordings took."""
    judged = [one.judged for one in cases if one.judged.form == "full"]
    singles = [j for j in judged if j.kind == "singles"]
    rows = [
        _least(
            f"right name first, effect/noise {level:g}",
            [j for j in singles if j.level == level],
            lambda j: j.right_first,
            least,
        )
        for level, least in ((0.3, 0.85), (0.6, 0.97), (1.5, 0.99))
    ]
    clear = [j for j in singles if j.level >= 0.6]
    rows.append(_least("truth in the reported set, at 0.6 and more", clear, _in_set, 0.99))
    named = [j for j in clear if not CONSTANTS & set(j.truths)]
    words = "right name first, at 0.6 and more, without the three constants"
    rows.append(_share(words, named, lambda j: j.right_first, NO_GOAL))
    pairs = [j for j in judged if j.kind == "pairs"]
    rows.append(_least("masked pairs, both named", pairs, _both_named, 0.93))
    rows.append(_share("masked pairs, both in the reported set", pairs, _in_set, NO_GOAL))
    plain = [*clear, *pairs]
    words = "right set and nothing else, at 0.6 and more, and pairs"
    rows.append(_least(words, plain, _right_set, 0.95))
    decoys = [j for j in judged if j.kind == "decoys"]
    rows.append(_most("false alarms on decoys", decoys, lambda j: not j.clean, 0.01))
    missing = [j for j in judged if j.kind == "missing"]
    rows.append(_most("family withheld: wrong name outside twins", missing, _invented, 0.03))
    rows.append(_least("family withheld: said to be unknown", missing, _unknown, 0.85))
    aliens = [j for j in judged if j.kind == "aliens"]
    rows.append(_least("alien effects said to be unknown", aliens, _unknown, 0.95))
    beside = [j for j in judged if j.kind == "beside"]
    words = "beside an unknown effect five times as strong"
    rows.append(_least(f"right name {words}", beside, lambda j: j.truths[-1] in j.named, 0.9))
    rows.append(_most(f"false name {words}", beside, _invented, 0.0))
    triples = [j for j in judged if j.kind == "triples"]
    rows.append(
        _least("three effects at once: right set and nothing else", triples, _right_set, 0.8)
    )
    rows += [*_other_worlds(judged), _closeness(plain), *_coverage(judged)]
    return [*rows, *_residuals(cases), *_gains(cases), _time(long_s)]


def _other_worlds(judged: Sequence[Judgement]) -> list[Figure]:
    """Slower recordings, machines of other sizes, loads that nobody measured, friction behind."""
    rows, empty = [], []
    for kind in ("rates", "sizes", "loads"):
        of = [j for j in judged if j.kind == kind]
        empty += [j for j in of if not j.truths]
        for group in sorted({j.group for j in of}):
            hidden = [j for j in of if j.truths and j.group == group]
            words = f"{kind}, {group}: right name first"
            rows.append(_share(words, hidden, lambda j: j.right_first, NO_GOAL))
            if kind == "loads":
                words += ", or said to be like the load"
                rows.append(_share(words, hidden, _named_or_said, NO_GOAL))
        hidden = [j for j in of if j.truths]
        rows.append(_share(f"{kind}: false name", hidden, _invented, NO_GOAL))
    words = "nothing hidden in them: false alarms"
    rows.append(_most(words, empty, lambda j: not j.clean, 0.01))
    behind = [j for j in judged if j.kind == "behind"]
    words = "friction behind a gap or a soft belt: right name first"
    rows.append(_share(words, behind, lambda j: j.right_first, NO_GOAL))
    return rows


def _named_or_said(j: Judgement) -> bool:
    return j.right_first or (j.kind == "loads" and bool(j.told_hidden))


def _time(long_s: float | None) -> Figure:
    """``long_s``: infinite where it failed."""
    met = None if long_s is None else long_s <= 10.0
    if long_s == math.inf:
        return Figure(_LONG, None, None, None, 1, "≤ 10 s", met, percent=False)
    return Figure(_LONG, long_s, None, None, int(long_s is not None), "≤ 10 s", met, percent=False)


def _in_set(j: Judgement) -> bool:
    return j.all_in_set


def _right_set(j: Judgement) -> bool:
    return j.all_in_set and not j.invented and not j.said_unknown


def _both_named(j: Judgement) -> bool:
    return len(j.named) == len(j.truths)


def _invented(j: Judgement) -> bool:
    return bool(j.invented) or not j.answered


def _unknown(j: Judgement) -> bool:
    return j.said_unknown


def _least(what: str, cases: Sequence[Judgement], hit: Hit, least: float) -> Figure:
    return _share(what, cases, hit, f"≥ {least:.0%}", lambda value: value >= least)


def _most(what: str, cases: Sequence[Judgement], hit: Hit, most: float) -> Figure:
    return _share(what, cases, hit, f"≤ {most:.0%}", lambda value: value <= most)


def _share(
    what: str,
    cases: Sequence[Judgement],
    hit: Hit,
    goal: str,
    good: Callable[[float], bool] | None = None,
) -> Figure:
    share = Share(what, sum(map(hit, cases)), len(cases))
    return _of_share(share, goal, good)


def _of_share(share: Share, goal: str, good: Callable[[float], bool] | None) -> Figure:
    if not share.cases:
        return Figure(share.what, None, None, None, 0, goal, None)
    value = share.hits / share.cases
    met = None if good is None else good(value)
    return Figure(share.what, value, *share.interval, share.cases, goal, met)


def _closeness(judged: Sequence[Judgement]) -> Figure:
    """Of the numbers of effects that were rightly named, at 0.6 and more and in pairs."""
    close = [abs(e.relative_error) <= _allowed(e) for j in judged for e in j.estimates]
    words = f"parameters within {_CLOSE:.0%} (Stribeck, dwell, delays: {_LESS_CLOSE:.0%})"
    return _of_share(Share(words, sum(close), len(close)), NO_GOAL, None)


def _allowed(e: Estimate) -> float:
    loose = e.effect in ("stribeck", "breakaway_dwell") or e.parameter == "delay_s"
    return _LESS_CLOSE if loose else _CLOSE


def _coverage(judged: Sequence[Judgement]) -> list[Figure]:
    """Of 90 % intervals, and of the 95 % ones that a diagnosis gives, of which they are made."""
    estimates = [e for j in judged for e in j.estimates]
    inside = [e.covered_90 for e in estimates if e.covered_90 is not None]
    share = Share("90 % intervals that hold the truth (parameters)", sum(inside), len(inside))
    given = [e.covered for e in estimates if e.covered is not None]
    without = f"; {len(estimates) - len(given)} parameters have none"
    whole = Share(f"95 % intervals as given{without}", sum(given), len(given))
    return [
        _of_share(share, "85–95 %", lambda value: 0.85 <= value <= 0.95),
        _of_share(whole, NO_GOAL, None),
    ]


def _residuals(cases: Sequence[Scored]) -> list[Figure]:
    """Held-out residual with what was found over that with the truth."""
    pairs = _pairs(cases, "residual_nm", ("augmented", "oracle"))
    words = "held-out residual ÷ the true model's"
    few = Share(f"{words}, at most {_AS_GOOD}", int(np.sum(_ratios(pairs) <= _AS_GOOD)), len(pairs))
    return [
        _ratio(f"{words}, median case", pairs, _median_ratio, "≤ 1.05", lambda v: v <= 1.05),
        _ratio(f"{words}, all cases pooled", pairs, _pooled_ratio, "≤ 1.05", lambda v: v <= 1.05),
        _of_share(few, NO_GOAL, None),
    ]


def _gains(cases: Sequence[Scored]) -> list[Figure]:
    """What of the true model's gain in rack force the augmented model has."""
    rows = _pairs(cases, "rack_force_rmse_n", ("baseline", "augmented", "oracle"))
    worthwhile = rows[rows[:, 2] < (1.0 - _LEAST_GAIN) * rows[:, 0]] if len(rows) else rows
    words = "share of the true model's rack-force gain"
    return [
        _ratio(f"{words}, all cases pooled", rows, _pooled_gain, "≥ 90 %", _enough, percent=True),
        _ratio(f"{words}, median case", worthwhile, _median_gain, "≥ 90 %", _enough, percent=True),
    ]


def _enough(value: float) -> bool:
    return value >= 0.9


def _pairs(cases: Sequence[Scored], name: str, models: Sequence[str]) -> Floats:
    """(n, models) of hidden single and paired effects that a model file can hold.

    A case without a diagnosis counts with the model as it was.
    """
    rows = []
    for one in cases:
        if one.judged.kind not in ("singles", "pairs") or "oracle" not in one.worth:
            continue
        worth = {**one.worth, "augmented": one.worth.get("augmented", one.worth["baseline"])}
        if worth["augmented"][name] is None:  # it has no figure, so it is worth nothing
            worth["augmented"] = worth["baseline"]
        row = [worth[model][name] for model in models]
        if all(value is not None for value in row):
            rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, len(models))


def _ratios(rows: Floats) -> Floats:
    return np.asarray(rows[:, 0] / rows[:, 1])


def _median_ratio(rows: Floats) -> float:
    return float(np.median(_ratios(rows)))


def _pooled_ratio(rows: Floats) -> float:
    return float(np.sqrt(np.sum(rows[:, 0] ** 2) / np.sum(rows[:, 1] ** 2)))


def _pooled_gain(rows: Floats) -> float:
    return float(np.sum(rows[:, 0] - rows[:, 1]) / np.sum(rows[:, 0] - rows[:, 2]))


def _median_gain(rows: Floats) -> float:
    return float(np.median((rows[:, 0] - rows[:, 1]) / (rows[:, 0] - rows[:, 2])))


def _ratio(
    what: str,
    rows: Floats,
    of: Callable[[Floats], float],
    goal: str,
    good: Callable[[float], bool],
    *,
    percent: bool = False,
) -> Figure:
    n = len(rows)
    if n == 0:
        return Figure(what, None, None, None, 0, goal, None, percent)
    rng = np.random.default_rng(1)
    drawn = [of(rows[rng.integers(0, n, n)]) for _ in range(_RESAMPLES)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    value = of(rows)
    return Figure(what, value, float(low), float(high), n, goal, good(value), percent)


def table(rows: Sequence[Figure]) -> str:
    """The rows as text."""
    width = max(len(row.what) for row in rows)
    lines = [f"{'figure':<{width}}  {'found (95 % interval)':<26}{'cases':>7}  {'goal':<9}"]
    for row in rows:
        lines.append(
            f"{row.what:<{width}}  {row.text:<26}{row.cases:>7}  {row.goal:<9}{row.verdict}"
        )
    return "\n".join(lines) + "\n"


def as_json(rows: Sequence[Figure]) -> list[dict[str, Any]]:
    """The rows as plain values."""
    return [
        {
            "figure": row.what,
            "value": row.value,
            "ci95": [row.low, row.high],
            "cases": row.cases,
            "goal": row.goal,
            "met": row.met,
        }
        for row in rows
    ]
