"""How sure fitted numbers are, where residuals are correlated and few places say anything.

A sandwich over groups of samples takes the residuals of one group for one observation. Which
groups are right nobody knows (an error of form lasts as long as a manoeuvre does), so samples,
blocks and stretches are all tried and the widest counts. A number that only a few groups tell
anything of has few degrees of freedom, whatever the length of the recordings: its half width is
Student's for as many groups as its information is spread over.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.data.size import ORDINARY, Size
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Parameter, Probe
from eps_hil.unit_words import spaced

Floats = npt.NDArray[np.float64]
Ends = tuple[float, float]
Integers = npt.NDArray[np.int64]

_IN_STRETCH = 5
"""Blocks."""
FEWEST = 2.0
"""Least degrees of freedom: fewer would make an interval of everything."""


def partitions(blocks: Sequence[Integers]) -> tuple[Integers, Integers]:
    """Groups for :func:`half_widths`: each recording's blocks numbered on, and stretches of them.

    ``blocks``: of each recording, the block of each sample, ascending; one may have no samples.
    """
    fine, wide = [], []
    first = 0
    for block in blocks:
        fine.append(block + first)
        wide.append(block // _IN_STRETCH + first)
        first += int(block[-1]) + 1 if len(block) else 0
    return np.concatenate(fine), np.concatenate(wide)


_MOST_NOISE = 0.99
"""Of the curvature in any direction: what is left of it is not known to be nothing."""


def less_noise(normal: Floats, noise: Floats) -> Floats:
    """A normal matrix (p, p) without what ``noise`` (p,) in the sensitivities adds to its diagonal.

    A signal at another delay has other noise of the same size: what that makes of a sensitivity is
    no curvature of the loss. No direction loses all of its curvature.
    """
    if not np.any(noise):
        return normal
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    value, turned = np.linalg.eigh(normal / np.outer(size, size))
    root = turned / np.sqrt(np.maximum(value, 1e-12))
    most = float(np.linalg.eigvalsh(root.T @ (root * (noise / size**2)[:, None]))[-1])
    return np.asarray(normal - np.diag(noise) * min(1.0, _MOST_NOISE / max(most, 1e-300)))


def half_widths(
    jacobian: Floats,
    residual: Floats,
    groups: Sequence[Integers],
    prior: int = 0,
    noise: Floats | None = None,
) -> Floats:
    """Half widths (p,) of 95 % intervals of numbers with the sensitivities ``jacobian`` (n, p).

    ``groups``: for each partition tried, the group of each sample, ascending, (n,). The first
    ``prior`` numbers have a prior of width one. ``noise`` (p,): energy that noise has in each
    sensitivity.
    """
    widths, _, _ = parts(jacobian, residual, groups, prior, noise)
    return np.max(widths, axis=0)


def parts(
    jacobian: Floats,
    residual: Floats,
    groups: Sequence[Integers],
    prior: int = 0,
    noise: Floats | None = None,
) -> tuple[Floats, Floats, Floats]:
    """(half widths, deviations, degrees of freedom), each by partition, (1 + partitions, p).

    The first partition is samples alone.
    """
    from scipy.special import stdtrit

    normal = jacobian.T @ jacobian
    known = np.zeros(len(normal))
    known[:prior] = 1.0
    normal += np.diag(known)
    if noise is not None:
        normal = less_noise(normal, noise)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    inverse = np.linalg.pinv(normal / np.outer(size, size)) / np.outer(size, size)
    pull = jacobian @ inverse  # what each sample moves each number by, for a residual of one
    own = inverse**2 @ known
    moved, told = pull * residual[:, None], pull**2
    deviations, freedom = [], []
    for group in (np.arange(len(residual)), *groups):
        first = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
        each = np.add.reduceat(moved, first, axis=0)
        share = np.add.reduceat(told, first, axis=0)
        total = np.sum(share, axis=0)
        count = total**2 / np.maximum(np.sum(share**2, axis=0), 1e-300)
        free = np.maximum(count - 1.0, FEWEST)
        deviations.append(np.sqrt(np.sum(each**2, axis=0) * (free + 1.0) / free + own))
        freedom.append(free)
    sigma, degrees = np.array(deviations), np.array(freedom)
    return np.asarray(stdtrit(degrees, 0.975) * sigma), sigma, degrees


def left_open(findings: Sequence[Mapping[str, Any]], size: Size = ORDINARY) -> list[str]:
    """A sentence (CONTRACT 7, ``limits``) for each finding with a number that is hardly known.

    That is one whose 95 % interval goes beyond what the effect can be, or whose fit ended on the
    bound of that.
    """
    said = []
    for finding in findings:
        effect = catalogue().get(finding["effect"])
        if effect is None:
            continue
        found = finding["parameters"]
        open_ones = [
            _range(found[one.name], one, size.bounds(one, effect))
            for one in effect.parameters
            if one.name in found
            and _open(found[one.name], one, effect.probe, size.bounds(one, effect))
        ]
        if open_ones:
            said.append(
                f"{finding['effect']}: these recordings leave open {' and '.join(open_ones)}. The "
                "model fits here; elsewhere it may not. Recordings in which the effect comes in "
                "other sizes (speeds, loads, places, rests) would settle it."
            )
    return said


def _open(told: Mapping[str, Any], one: Parameter, probe: Probe | None, ends: Ends) -> bool:
    """What turns round has no bound; intervals are of the torque balance's own effects only."""
    if told["ci95"] is None or one.closed or (probe is not None and one.name == probe.phase):
        return False
    return _on_bound(told, ends) or (probe is not None and _beyond(told, ends))


def _beyond(told: Mapping[str, Any], ends: Ends) -> bool:
    low, high = told["ci95"]
    return bool(low < ends[0] or high >= ends[1])


def _on_bound(told: Mapping[str, Any], ends: Ends) -> bool:
    return bool(np.any(np.isclose(told["value"], ends, rtol=1e-6, atol=0.0)))


def _range(told: Mapping[str, Any], one: Parameter, ends: Ends) -> str:
    low, high = told["ci95"]
    unit = spaced(one.unit)
    if _on_bound(told, ends):
        return f"{one.name} (it ended at {told['value']:.3g}{unit}, the bound of what it can be)"
    if low < ends[0] and high > ends[1]:
        return one.name
    if low < ends[0]:
        return f"{one.name} (anything up to {high:.3g}{unit})"
    return f"{one.name} ({low:.3g}{unit} or more)"
