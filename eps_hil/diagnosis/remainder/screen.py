"""Every law of the grammar against what is left: fitted on the recordings, judged on hold-outs.

Columns are linear in a law's size. What the accepted effects' own numbers could do is projected
out. The gate's null is the same search on residuals whose blocks were turned upside down at random:
no law can hold in both signs, and what is left keeps its size, its place and its correlation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.remainder.grammar import Law, laws, rank, rows_of
from eps_hil.diagnosis.remainder.refine import orthonormal
from eps_hil.diagnosis.remainder.sight import Sight

Floats = npt.NDArray[np.float64]

NULLS = 24
_SEED = 20
_KEPT, _OF_FAMILY = 60, 3
_NOTHING = 1e-9
_AT_ONCE = 16
"""Laws that are worked on together, by one core."""
_MOSTLY = 1e-3
"""Share of a column's square that is left beside the numbers that may move: of less, the difference
of two sums would be rounding."""


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
    carried: Floats = np.zeros((len(ours), 0))
    moved: Floats = np.zeros((len(theirs), 0))
    if free is not None:
        here, moved = (
            part[sight.rows] * sight.weight[sight.rows, None]
            for part, sight in zip(free, (fitted, kept), strict=True)
        )
        carried = np.asarray(np.linalg.pinv(here)).T
    basis = orthonormal(jacobian[fitted.rows] * fitted.weight[fitted.rows, None])
    beside, width = np.hstack([basis, carried]), basis.shape[1]
    turned = _Turned(fitted)
    within = basis.T @ turned.columns
    other = _Turned(kept).columns

    def tried(some: Sequence[Law]) -> tuple[list[Screened], Floats]:
        rows = [(law, rows_of(law, fitted), rows_of(law, kept)) for law in some]
        there = [(law, x, y) for law, x, y in rows if x is not None and y is not None]
        if not there:
            return [], np.full(1 + NULLS, -np.inf)
        x = np.concatenate([x for _, x, _ in there]) * ours
        y = np.concatenate([y for _, _, y in there]) * theirs
        known = x @ beside
        y -= known[:, width:] @ moved.T
        known, sums = known[:, :width], turned.sums(x)
        square = _squares(x)
        # rather than of columns without what the basis can do: that would be two passes more
        poor = square - _squares(known) < _MOSTLY * square
        if poor.any():
            x[poor] -= known[poor] @ basis.T
            known[poor], sums[poor], square[poor] = (
                x[poor] @ basis, turned.sums(x[poor]), _squares(x[poor]),
            )  # fmt: skip
        xr, xx = sums - known @ within, square - _squares(known)
        widths = [len(one) for _, one, _ in there]
        gains, judged, sizes = _gains((x, known), xr, xx, y, y @ other, widths)
        found = [
            Screened(_sized(law, sizes[k]), float(gains[k]), float(judged[k, 0]))
            for k, (law, _, _) in enumerate(there)
        ]
        return found, np.max(judged, axis=0)

    found: list[Screened] = []
    most: Floats = np.zeros(1 + NULLS)
    for group in laws(fitted, fitted.residual * fitted.scale * fitted.use):
        pieces = [group[k : k + _AT_ONCE] for k in range(0, len(group), _AT_ONCE)]
        for some, best in each(tried, pieces):
            found += some
            most = np.maximum(most, best)
        found = _best(found)
        fitted.forget()
        kept.forget()
    return Screening(found, most[1:], float(most[0]))


def _best(found: Sequence[Screened]) -> list[Screened]:
    """The best, with no more than a few shapes of one family, each with its best numbers."""
    kept: list[Screened] = []
    shapes: dict[tuple[object, ...], set[tuple[str, ...]]] = {}
    for one in sorted(found, key=lambda one: (-float(f"{one.worth:.11e}"), rank(one.law))):
        there = shapes.setdefault(one.law.family, set())
        shape = tuple(factor.shape for factor in one.law.inputs)
        if len(kept) < _KEPT and len(there) < _OF_FAMILY and shape not in there:
            kept.append(one)
            there.add(shape)
    return kept


def _weights(sight: Sight) -> Floats:
    return (sight.weight / sight.scale)[sight.rows]


def _squares(rows: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", rows, rows))


def _gains(
    columns: tuple[Floats, Floats],
    xr: Floats,
    xx: Floats,
    y: Floats,
    ys: Floats,
    widths: Sequence[int],
) -> tuple[Floats, Floats, list[Floats]]:
    """(gain on the fitted (k,), gains on the hold-outs (k, 1 + NULLS), sizes of the real one).

    ``columns``: of the fitted, lying, and what the basis holds of each.
    """
    yy = _squares(y)[:, None]
    size = -xr / np.maximum(xx, _NOTHING)[:, None]
    fitted = -(size * xr)[:, 0]
    judged = -2.0 * size * ys - size**2 * yy
    first = np.cumsum([0, *widths])[:-1]
    sizes = [size[at : at + width, 0] for at, width in zip(first, widths, strict=True)]
    for k, (at, width) in enumerate(zip(first, widths, strict=True)):
        if width == 1:
            continue
        both = slice(at, at + width)
        x, known = (one[both] for one in columns)
        inverse = np.linalg.pinv(x @ x.T - known @ known.T, rcond=1e-10, hermitian=True)
        solved = -inverse @ xr[both]
        gram = y[both] @ y[both].T
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


class _Turned:
    """The weighted residual at the rows, and with blocks turned upside down."""

    def __init__(self, sight: Sight) -> None:
        rng = np.random.default_rng(_SEED)
        block = sight.block[sight.rows]
        signs = [rng.choice([-1.0, 1.0], int(np.max(sight.block)) + 1) for _ in range(NULLS)]
        self.real = (sight.residual * sight.weight)[sight.rows]
        self.columns = np.column_stack([self.real, *(self.real * one[block] for one in signs)])
        """(n, 1 + NULLS)."""
        self._starts = np.flatnonzero(np.diff(block, prepend=-1))
        there = block[self._starts]
        self._signs = np.column_stack([np.ones(len(there)), *(one[there] for one in signs)])

    def sums(self, rows: Floats) -> Floats:
        """Each of ``rows`` (k, n) times each of the columns, (k, 1 + NULLS): block by block."""
        by_block = np.add.reduceat(rows * self.real, self._starts, axis=1)
        return np.asarray(by_block @ self._signs)
