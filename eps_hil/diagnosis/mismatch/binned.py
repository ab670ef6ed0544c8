"""A curve over one coordinate: means in bins, and what they explain of blocks not drawn from."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Places = npt.NDArray[np.int64]


def places(edges: Floats, values: Floats) -> Places:
    """(n,): the bin between two ``edges`` (k + 1,) that each of ``values`` (n,) falls into."""
    found = np.searchsorted(edges, values, side="right") - 1
    return np.asarray(np.clip(found, 0, len(edges) - 2), np.int64)


def means(place: Places, values: Floats, n: int, fewest: int = 1) -> Floats:
    """(n,): means of ``values`` in ``n`` bins; zero where fewer than ``fewest`` fell into one."""
    total = np.bincount(place, weights=values, minlength=n)
    count = np.bincount(place, minlength=n)
    return np.asarray(total / np.maximum(count, 1) * (count >= fewest))


def gain_elsewhere(place: Places, values: Floats, block: Places, n: int, fewest: int = 1) -> float:
    """What the means of even blocks take off the squares of the odd ones, and the other way."""
    gain = 0.0
    for part in (0, 1):
        drawn, judged = block % 2 == part, block % 2 != part
        guess = means(place[drawn], values[drawn], n, fewest)[place[judged]]
        gain += float(np.sum(values[judged] ** 2 - (values[judged] - guess) ** 2))
    return gain


def points(edges: Floats, mean: Floats, band: Floats) -> tuple[tuple[float, float, float], ...]:
    """A curve as (middle of the bin, mean, band)."""
    centre = 0.5 * (edges[1:] + edges[:-1])
    return tuple(zip(centre.tolist(), mean.tolist(), band.tolist(), strict=True))
