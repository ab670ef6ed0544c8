"""Other people's methods, each as one call: rows of signals and a torque in, a model out.

Each is used as its own documentation shows it, on standardised signals; what has to be chosen is
chosen on the last third of every recording. Imports are lazy: nothing here is a dependency.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Record = tuple[Floats, Floats, Flags]
"""Signals (m, 6), torque (m,) Nm, and which samples count (m,)."""

GP_POINTS = 500


@dataclass(frozen=True)
class Learnt:
    """A model of a torque (Nm) from signals (n, 6); outside what was seen it is held."""

    predict: Callable[[Floats], Floats]
    low: Floats
    high: Floats
    centre: Floats
    width: Floats
    terms: int | None = None
    memory: int = 0
    """Samples (8 ms) that it has to be told of before those that are asked; 0: it has no memory."""

    def __call__(self, signals: Floats) -> Floats:
        """The torque, (n,)."""
        inside = np.clip(np.nan_to_num(signals), self.low, self.high)
        return np.asarray(self.predict((inside - self.centre) / self.width)).reshape(-1)


Fit = Callable[[Floats, Floats], tuple[Callable[[Floats], Floats], int | None]]


def _learnt(records: Sequence[Record], choices: Sequence[Fit]) -> Learnt:
    """The best of ``choices`` on each recording's last third, fitted to everything again."""
    every = np.vstack([rows[use] for rows, _, use in records])
    centre, width = np.mean(every, axis=0), np.maximum(np.std(every, axis=0), 1e-9)
    early, late = [], []
    for rows, torque, use in records:
        scaled, cut = (rows - centre) / width, 2 * len(rows) // 3
        first = np.arange(len(rows)) < cut
        early.append((scaled[use & first], torque[use & first]))
        late.append((scaled[use & ~first], torque[use & ~first]))
    (x, y), (x_late, y_late) = (
        tuple(np.concatenate([part[k] for part in some]) for k in (0, 1)) for some in (early, late)
    )
    best = choices[0]
    if len(choices) > 1:
        left = [float(np.mean((fit(x, y)[0](x_late) - y_late) ** 2)) for fit in choices]
        best = choices[int(np.argmin(left))]
    predict, terms = best(np.vstack([x, x_late]), np.concatenate([y, y_late]))
    return Learnt(predict, every.min(axis=0), every.max(axis=0), centre, width, terms)


def boosted_trees(records: Sequence[Record]) -> Learnt:
    """scikit-learn's histogram gradient boosting."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    def fit(leaves: int) -> Fit:
        def trained(x: Floats, y: Floats) -> tuple[Callable[[Floats], Floats], None]:
            trees = HistGradientBoostingRegressor(
                max_iter=200, max_leaf_nodes=leaves, learning_rate=0.06, random_state=0
            )
            return trees.fit(x, y).predict, None

        return trained

    return _learnt(records, [fit(8), fit(31)])


def gaussian_process(records: Sequence[Record]) -> Learnt:
    """scikit-learn's Gaussian process: one length for each signal, white noise beside."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    def trained(x: Floats, y: Floats) -> tuple[Callable[[Floats], Floats], None]:
        few = np.random.default_rng(0).permutation(len(x))[:GP_POINTS]
        kernel = ConstantKernel(1.0) * RBF(np.ones(x.shape[1]), (0.05, 1e3)) + WhiteKernel(0.5)
        process = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0)
        return process.fit(x[few], y[few]).predict, None

    return _learnt(records, [trained])


def sparse_regression(records: Sequence[Record]) -> Learnt:
    """PySINDy: STLSQ on polynomials to degree 3 of the signals."""
    import pysindy

    def fit(threshold: float) -> Fit:
        def trained(x: Floats, y: Floats) -> tuple[Callable[[Floats], Floats], int]:
            library = pysindy.PolynomialLibrary(degree=3)
            scale = float(np.std(y)) or 1.0
            model = pysindy.SINDy(
                optimizer=pysindy.STLSQ(threshold=threshold, alpha=1e-3, normalize_columns=False),
                feature_library=library,
            )
            model.fit(x, t=0.008, x_dot=np.column_stack([y / scale]))
            terms = int(np.count_nonzero(model.coefficients()))
            return (lambda z: scale * np.asarray(model.predict(z))[:, 0]), terms

        return trained

    return _learnt(records, [fit(one) for one in (0.02, 0.1, 0.4)])


def narx(records: Sequence[Record]) -> Learnt:
    """SysIdentPy: FROLS on polynomials of degree 2 of the signals, no past values."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    def fit(terms: int) -> Fit:
        def trained(x: Floats, y: Floats) -> tuple[Callable[[Floats], Floats], int]:
            model = FROLS(
                order_selection=False, n_terms=terms, ylag=1, xlag=[[1]] * x.shape[1],
                model_type="NFIR", basis_function=Polynomial(degree=2), estimator=LeastSquares(),
            )  # fmt: skip
            model.fit(X=x[1:], y=y[:-1, None])  # its least lag is one sample: here none

            def predict(z: Floats) -> Floats:
                made = model.predict(X=np.vstack([z[1:], z[-1:]]), y=np.zeros((1, 1)))
                made[0] = made[1]  # where it begins it gives back what it was told
                return np.asarray(made)[:, 0]

            return predict, terms

        return trained

    return _learnt(records, [fit(one) for one in (2, 6, 15)])


def lstm(records: Sequence[Record]) -> Learnt:
    """One layer of LSTM cells over all signals (``arena_lstm.py``), cells chosen as all else is."""
    from arena_lstm import CELLS, STRETCH, trained

    every = np.vstack([rows[use] for rows, _, use in records])
    low, high = every.min(axis=0), every.max(axis=0)
    centre, width = np.mean(every, axis=0), np.maximum(np.std(every, axis=0), 1e-9)
    scale = float(np.std(np.concatenate([torque[use] for _, torque, use in records]))) or 1.0
    parts = [
        ((np.clip(rows, low, high) - centre) / width, torque / scale, use.astype(np.float64))
        for rows, torque, use in records
    ]
    early = [tuple(one[: 2 * len(one) // 3] for one in part) for part in parts]

    def left(cells: int) -> float:
        net, lost = trained(early, cells), []
        for rows, target, use in parts:
            late = np.arange(len(rows)) >= 2 * len(rows) // 3
            lost.append(((net.run(rows[None])[0] - target) ** 2)[late & (use > 0.0)])
        return float(np.mean(np.concatenate(lost)))

    net = trained(parts, min(CELLS, key=left))
    return Learnt(
        lambda rows: scale * net.run(rows[None])[0], low, high, centre, width, memory=STRETCH
    )


def _quiet(learn: Callable[[Sequence[Record]], Learnt]) -> Callable[[Sequence[Record]], Learnt]:
    def learn_quietly(records: Sequence[Record]) -> Learnt:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return learn(records)

    return learn_quietly


METHODS: Mapping[str, Any] = {
    "boosted trees (scikit-learn)": _quiet(boosted_trees),
    "Gaussian process (scikit-learn)": _quiet(gaussian_process),
    "PySINDy (STLSQ)": _quiet(sparse_regression),
    "SysIdentPy (FROLS)": _quiet(narx),
    "LSTM (NumPy)": lstm,
}
