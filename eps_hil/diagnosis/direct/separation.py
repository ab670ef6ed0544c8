"""Rotor and rack apart, and no name for it: a reproducible curve that the second residual shows."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.entry import place, unknown
from eps_hil.diagnosis.direct.rotor_and_rack import (
    LEAST_RATIO,
    USUAL,
    Rows,
    columns_of,
    least_compliance,
    solved,
)
from eps_hil.diagnosis.direct.seen import LEAST_GAIN
from eps_hil.diagnosis.mismatch.binned import gain_elsewhere, means, places, points
from eps_hil.diagnosis.mismatch.locate import BINS
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

LEAST_SHARE = 0.05
"""Least share of the residual's energy that a curve explains on blocks it was not drawn from."""
_FEWEST_BINS = 5
_BEYOND: Mapping[str, tuple[str, Callable[[Model], float]]] = {
    "compliance": ("belt_compliance", least_compliance),
    "ratio": ("rack_ratio", lambda _model: LEAST_RATIO),
}
"""Columns that every drive has a little of, the name of more of it, and where more begins."""


@dataclass(frozen=True)
class Separation:
    """A curve (x, rad at the rotor, band) over one signal; its share of the residual's energy."""

    signal: str
    curve: tuple[tuple[float, float, float], ...]
    share: float
    energy: float
    """All that is left beyond the noise, in noise variances."""
    alone: bool = False
    """Whether one such curve does better, without any name, than the names that were accepted."""

    def finding(self) -> dict[str, Any]:
        """The JSON entry (CONTRACT 7)."""
        size = max(abs(one[1]) for one in self.curve)
        return unknown(
            f"Rotor and rack move apart by up to {1e3 * size:.3g} mrad at the rotor in a way that "
            f"no effect of the catalogue explains; it follows {self.signal}.",
            0.95,
            [place(self.signal, self.curve[0][0], self.curve[-1][0], self.share)],
            self.curve,
            seen_in="kinematics",
        )


def separation(
    rows: Sequence[Rows], accepted: Sequence[str], without: Collection[str]
) -> Separation | None:
    """What is left once the accepted effects are taken out, if it is clear; None if nothing is.

    A little of what gives, and of a ratio that is off, is how drives are. More of it counts as
    left, where its name is in ``without``.
    """
    names = list(dict.fromkeys([*columns_of(accepted), *USUAL]))
    if "belt_compliance" in accepted:
        names.append("friction")  # of the rack, which a belt that gives carries too
    values, left = solved(rows, names)
    beyond = [
        column
        for column, (effect, least) in _BEYOND.items()
        if effect in without and abs(values[column]) > least(rows[0].model)
    ]
    if beyond:
        left = solved(rows, [name for name in names if name not in beyond])[1]
    best = _clear(_best(rows, left), left)
    if best is None:
        return None
    bare = solved(rows, columns_of(()))[1]
    curve = _clear(_best(rows, bare), bare)
    alone = curve is not None and (1.0 - curve.share) * _energy(bare) < _energy(left)
    return replace(curve, alone=True) if curve is not None and alone else best


def shown(one: Separation, kept: Sequence[Rows], accepted: Sequence[str]) -> bool:
    """Whether the curve lowers what the hold-outs leave of the same fit; yes, where there is none.

    Among many recordings one has such a curve by chance.
    """
    if not kept:
        return True
    names = columns_of(()) if one.alone else list(dict.fromkeys([*columns_of(accepted), *USUAL]))
    left = solved(kept, names)[1]
    x = np.concatenate([row.at[one.signal] for row in kept])
    sigma = np.concatenate([np.full(len(row.e), row.sigma) for row in kept])
    curve = np.interp(x, [point[0] for point in one.curve], [point[1] for point in one.curve])
    return _energy(left - curve / sigma) < _energy(left)


def _clear(curve: Separation | None, left: Floats) -> Separation | None:
    """The curve if it explains enough of what is ``left``; else None."""
    if curve is None or curve.share < LEAST_SHARE or curve.share * _energy(left) < LEAST_GAIN:
        return None
    return curve


def _energy(left: Floats) -> float:
    return float(np.sum(np.clip(left, -_far(left), _far(left)) ** 2))


def _best(rows: Sequence[Rows], left: Floats) -> Separation | None:
    """The curve that explains most of what is left."""
    cut = np.clip(left, -_far(left), _far(left))
    views = ("rack_force_n", "rack_position_m", "motor_speed_rad_s")
    found = [one for one in (_curve(rows, name, cut) for name in views) if one is not None]
    return max(found, key=lambda one: one.share, default=None)


def _far(left: Floats) -> float:
    return max(5.0, 6.0 * 1.4826 * float(np.median(np.abs(left))))


def _curve(rows: Sequence[Rows], name: str, left: Floats) -> Separation | None:
    """The mean of what is ``left`` (noise deviations) over a signal, judged on other blocks."""
    x = np.concatenate([one.at[name] for one in rows])
    block = np.concatenate([one.block for one in rows])
    sigma = np.concatenate([np.full(len(one.e), one.sigma) for one in rows])
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    if len(edges) <= _FEWEST_BINS:
        return None
    place, n = places(edges, x), len(edges) - 1
    mean = means(place, left * sigma, n)
    square = means(place, (left * sigma) ** 2, n)
    count = np.maximum(np.bincount(place, minlength=n), 1)
    band = 2.0 * np.sqrt(np.maximum(square - mean**2, 0.0) / count)
    total = float(np.sum(left**2))
    share = gain_elsewhere(place, left, block, n) / max(total, 1e-300)
    return Separation(name, points(edges, mean, band), share, total - len(left))
