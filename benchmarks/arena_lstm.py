"""A small LSTM (Hochreiter and Schmidhuber 1997) on the torque that a model leaves, by NumPy alone.

One layer, trained by Adam on stretches of the recordings, gradients by backpropagation through
time; the number of cells is chosen on each recording's last third. Written out because a framework
for it brings gigabytes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

STEP_S = 0.008
STRETCH, BATCH, EPOCHS = 125, 32, 300
CELLS = (8, 24)
_RATE, _BETAS, _CLIP = 5e-3, (0.9, 0.999), 1.0
_HELD = 12
"""Samples at the start of a stretch that do not count: the cells fill."""


@dataclass
class Lstm:
    """Weights: gates (inputs + cells + 1, 4 cells), in the order in, forget, out, new; a line."""

    gates: Floats
    line: Floats
    """(cells + 1,)."""

    @classmethod
    def drawn(cls, inputs: int, cells: int, rng: np.random.Generator) -> "Lstm":
        """Random weights; a forget gate begins open."""
        gates = rng.normal(size=(inputs + cells + 1, 4 * cells)) / np.sqrt(inputs + cells)
        gates[-1] = 0.0
        gates[-1, cells : 2 * cells] = 1.0
        return cls(gates, np.append(rng.normal(size=cells) / np.sqrt(cells), 0.0))

    def run(self, x: Floats, keep: list[tuple[Floats, ...]] | None = None) -> Floats:
        """Answers (batch, n) to inputs (batch, n, p); ``keep`` takes what the gradient needs."""
        batch, n, _ = x.shape
        cells = len(self.line) - 1
        state, memory = np.zeros((batch, cells)), np.zeros((batch, cells))
        out, one = np.empty((batch, n)), np.ones((batch, 1))
        for k in range(n):
            seen = np.hstack([x[:, k], state, one])
            raw = seen @ self.gates
            gate = 1.0 / (1.0 + np.exp(-np.clip(raw[:, : 3 * cells], -40.0, 40.0)))
            take, hold, show = gate[:, :cells], gate[:, cells : 2 * cells], gate[:, 2 * cells :]
            new, before = np.tanh(raw[:, 3 * cells :]), memory
            memory = hold * before + take * new
            bent = np.tanh(memory)
            state = show * bent
            out[:, k] = state @ self.line[:-1] + self.line[-1]
            if keep is not None:
                keep.append((seen, take, hold, show, new, before, bent, state))
        return out

    def gradient(self, x: Floats, y: Floats, use: Floats) -> tuple[float, Floats, Floats]:
        """Mean square of what counts (``use``, (batch, n)) and its gradients."""
        kept: list[tuple[Floats, ...]] = []
        error = use * (self.run(x, kept) - y)
        many = max(float(np.sum(use)), 1.0)
        gates, line = np.zeros_like(self.gates), np.zeros_like(self.line)
        inputs, cells = x.shape[2], len(self.line) - 1
        to_state, to_memory = np.zeros((len(x), cells)), np.zeros((len(x), cells))
        for k in range(x.shape[1] - 1, -1, -1):
            seen, take, hold, show, new, before, bent, state = kept[k]
            wrong = 2.0 * error[:, k : k + 1] / many
            line[:-1] += state.T @ wrong[:, 0]
            line[-1] += np.sum(wrong)
            to_state = to_state + wrong * self.line[:-1]
            to_memory = to_memory + to_state * show * (1.0 - bent**2)
            raw = np.hstack([
                to_memory * new * take * (1.0 - take),
                to_memory * before * hold * (1.0 - hold),
                to_state * bent * show * (1.0 - show),
                to_memory * take * (1.0 - new**2),
            ])  # fmt: skip
            gates += seen.T @ raw
            to_state = raw @ self.gates[inputs : inputs + cells].T
            to_memory = to_memory * hold
        return float(np.sum(error**2)) / many, gates, line


def trained(parts: Sequence[tuple[Floats, Floats, Floats]], cells: int) -> Lstm:
    """On (inputs (n, p), target (n,), what counts (n,)) of each recording, all scaled."""
    rng = np.random.default_rng(0)
    cut = [
        (rows[k : k + STRETCH], target[k : k + STRETCH], use[k : k + STRETCH])
        for rows, target, use in parts
        for k in range(0, len(rows) - STRETCH + 1, STRETCH // 2)
    ]
    x, y, use = (np.array([one[k] for one in cut]) for k in range(3))
    use = use.copy()
    use[:, :_HELD] = 0.0
    net = Lstm.drawn(x.shape[2], cells, rng)
    moments, step = [np.zeros((2, *one.shape)) for one in (net.gates, net.line)], 0
    for epoch in range(EPOCHS):
        rate = _RATE * 0.5 * (1.0 + np.cos(np.pi * epoch / EPOCHS))
        order = rng.permutation(len(x))
        for k in range(0, len(order), BATCH):
            some, step = order[k : k + BATCH], step + 1
            _, *slopes = net.gradient(x[some], y[some], use[some])
            size = np.sqrt(sum(float(np.sum(one**2)) for one in slopes))
            share = min(1.0, _CLIP / max(float(size), 1e-12))
            net.gates -= rate * _adam(moments[0], share * slopes[0], step)
            net.line -= rate * _adam(moments[1], share * slopes[1], step)
    return net


def _adam(moments: Floats, slope: Floats, step: int) -> Floats:
    """A step's direction; ``moments`` (2, …) are moved along (Kingma and Ba 2015)."""
    first, second = _BETAS
    moments[0] += (1.0 - first) * (slope - moments[0])
    moments[1] += (1.0 - second) * (slope**2 - moments[1])
    spread = np.sqrt(moments[1] / (1.0 - second**step)) + 1e-8
    return np.asarray(moments[0] / (1.0 - first**step) / spread)
