"""Every law of the grammar against what is left: fitted on the recordings, judged on hold-outs.

Columns are linear in a law's size. What the accepted effects' own numbers could do is projected
out. The gate's null is the same search on residuals whose blocks were turned upside down at random:
no law can hold in both signs, and what is left keeps its size, its place and its correlation.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.remainder.grammar import Law, columns_of, laws
from eps_hil.diagnosis.remainder.refine import orthonormal
from eps_hil.diagnosis.remainder.sight import Sight

Floats = npt.NDArray[np.float64]

NULLS = 24
_SEED = 20
_KEPT, _OF_FAMILY = 60, 2
_NOTHING = 1e-9


@dataclass(frozen=True)
class Screened:
    """A law with its gains (noise variances) on the fitted recordings and on the hold-outs."""

    law: Law
    fitted: float
    judged: float

    @property
    def worth(self) -> float:
        """Both together, less the price of being complicated: a law has to hold everywhere."""
        return (self.fitted + self.judged) * (1.0 - self.law.price)


@dataclass(frozen=True)
class Screening:
    """The best laws, and the best hold-out gain that each null search reached, (NULLS,)."""

    best: Sequence[Screened]
    null: Floats
    """Best gain on hold-outs of each null search."""
    most: float
    """The same of the real one."""


def screen(
    fitted: Sight, kept: Sight, jacobian: Floats, free: tuple[Floats, Floats] | None = None
) -> Screening:
    """Try all laws; ``jacobian`` (n, p) of the fitted residual to numbers that may move with it.

    ``free`` (n, q), (m, q): sensitivities of both residuals to numbers that do move. By how much is
    said by the fitted recordings, so that the hold-outs judge a law with that.
    """
    ours, theirs = _weights(fitted), _weights(kept)
    carried: Floats = np.zeros((0, 0))
    moved: Floats = carried
    if free is not None:
        here, moved = (
            part[sight.rows] * sight.weight[sight.rows, None]
            for part, sight in zip(free, (fitted, kept), strict=True)
        )
        carried = np.asarray(np.linalg.pinv(here))
    basis = orthonormal(jacobian[fitted.rows] * fitted.weight[fitted.rows, None])
    left, other = _turned(fitted), _turned(kept)
    left -= basis @ (basis.T @ left)
    found: list[Screened] = []
    null, most = np.zeros(NULLS), 0.0
    for group in laws(fitted, fitted.residual * fitted.scale * fitted.use):
        columns = [(one, columns_of(one, fitted), columns_of(one, kept)) for one in group]
        there = [(one, x, y) for one, x, y in columns if x is not None and y is not None]
        if not there:
            continue
        x = np.hstack([x for _, x, _ in there]) * ours[:, None]
        y = np.hstack([y for _, _, y in there]) * theirs[:, None]
        if free is not None:
            y -= moved @ (carried @ x)
        x -= basis @ (basis.T @ x)
        gains, judged, sizes = _gains(x, left, y, other, [one.shape[1] for _, one, _ in there])
        null = np.maximum(null, np.max(judged[:, 1:], axis=0, initial=0.0))
        most = max(most, float(np.max(judged[:, 0])))
        found += [
            Screened(_sized(law, sizes[k]), float(gains[k]), float(judged[k, 0]))
            for k, (law, _, _) in enumerate(there)
        ]
        found = _best(found)
    return Screening(found, null, most)


def _best(found: Sequence[Screened]) -> list[Screened]:
    """The best, with no more than a few of one family: other numbers, or another shape."""
    kept: list[Screened] = []
    count: Counter[tuple[object, ...]] = Counter()
    for one in sorted(found, key=lambda one: -one.worth):
        if len(kept) < _KEPT and count[one.law.family] < _OF_FAMILY:
            kept.append(one)
            count[one.law.family] += 1
    return kept


def _weights(sight: Sight) -> Floats:
    return (sight.weight / sight.scale)[sight.rows]


def _gains(
    x: Floats, r: Floats, y: Floats, s: Floats, widths: Sequence[int]
) -> tuple[Floats, Floats, list[Floats]]:
    """(gain on the fitted (k,), gains on the hold-outs (k, 1 + NULLS), sizes of the real one)."""
    xr, ys = x.T @ r, y.T @ s
    xx, yy = np.sum(x**2, axis=0)[:, None], np.sum(y**2, axis=0)[:, None]
    size = -xr / np.maximum(xx, _NOTHING)
    fitted = -(size * xr)[:, 0]
    judged = -2.0 * size * ys - size**2 * yy
    first = np.cumsum([0, *widths])[:-1]
    sizes = [size[at : at + width, 0] for at, width in zip(first, widths, strict=True)]
    for k, (at, width) in enumerate(zip(first, widths, strict=True)):
        if width == 1:
            continue
        both = slice(at, at + width)
        solved = -np.linalg.pinv(x[:, both].T @ x[:, both], rcond=1e-10, hermitian=True) @ xr[both]
        gram = y[:, both].T @ y[:, both]
        sizes[k] = solved[:, 0]
        fitted[at] = -float(solved[:, 0] @ xr[both, 0])
        judged[at] = -2.0 * np.sum(solved * ys[both], axis=0) - np.sum(
            solved * (gram @ solved), axis=0
        )
    return fitted[first], judged[first], sizes


def _sized(law: Law, size: Floats) -> Law:
    if len(size) == 1:
        return replace(law, size=float(size[0]))
    phase = float(np.arctan2(size[1], size[0]))
    wave = len(law.inputs) - 1
    moved = law.with_numbers({(wave, "phase"): phase})
    return replace(moved, size=float(np.hypot(*size)))


def _turned(sight: Sight) -> Floats:
    """The weighted residual at the rows, and with blocks turned upside down, (k, 1 + NULLS)."""
    rng = np.random.default_rng(_SEED)
    block = sight.block[sight.rows]
    real = (sight.residual * sight.weight)[sight.rows]
    signs = [rng.choice([-1.0, 1.0], int(np.max(sight.block)) + 1)[block] for _ in range(NULLS)]
    return np.column_stack([real, *(real * one for one in signs)])
