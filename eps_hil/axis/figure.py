"""The held-out recording before and after: hidden force, its error, and what the balance leaves."""

from pathlib import Path

import numpy as np

from eps_hil.axis.proof import BAND_HZ, Proof
from eps_hil.diagnosis.data.prepare import EDGE_S, STEP_S
from eps_hil.identification.butterworth import low_pass
from eps_hil.report import figures

_SHOWN_S = (8.0, 14.0)


def draw(proof: Proof, path: str | Path) -> Path:
    """Three panels over time, published model against augmented one."""
    figure, axes = figures.subplots(3, 1, width_cm=25.0, height_cm=20.0)
    time = np.arange(len(proof.heldout.force_n)) * STEP_S
    truth = low_pass(proof.heldout.hidden_force_n, BAND_HZ)
    edge = round(EDGE_S / STEP_S)
    inside = slice(edge, len(time) - edge)
    here = (time >= _SHOWN_S[0]) & (time <= _SHOWN_S[1])
    models = (
        ("published model", proof.before, figures.COLOURS[1]),
        ("augmented model", proof.after, figures.COLOURS[0]),
    )
    for name, judged, colour in models:
        rmse, percent = judged.hidden_force_rmse_n, judged.heldout_force_error_percent
        style = {"color": colour, "linewidth": 0.9}
        axes[0, 0].plot(time[here], judged.hidden_force_n[here], label=name, **style)
        error = judged.hidden_error_n
        axes[1, 0].plot(time[here], error[here], label=f"{name}: {rmse:.2f} N rms", **style)
        axes[2, 0].plot(
            time[inside], judged.balance_error_n[inside], label=f"{name}: {percent:.2f} %", **style
        )
    axes[0, 0].plot(time[here], truth[here], "k--", linewidth=0.9, label="withheld from the tool")
    axes[0, 0].set_ylabel("hidden force in N")
    axes[1, 0].set_ylabel("its error in N")
    axes[1, 0].set_ylim(-20, 20)
    axes[2, 0].set_ylabel("force balance, known wave, in N")
    axes[2, 0].set_xlabel("time in s")
    for axis in axes[:, 0]:
        axis.legend(loc="upper right", ncols=3, fontsize="small", framealpha=0.9)
    return figures.save(figure, path)
