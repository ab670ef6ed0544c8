"""A golden beside what is estimated now, and their difference under it."""

from pathlib import Path

from eps_hil.oracle.golden import Estimates, common_rows
from eps_hil.report import figures


def draw(golden: Estimates, now: Estimates, tolerance_n: float, path: Path) -> None:
    """Rack force (N) over s since the golden's first row, where both are valid, to a file."""
    left, right = common_rows(golden, now)
    both = golden.valid[left] & now.valid[right]
    since_s = (golden.t_ns[left] - golden.t_ns[0])[both] * 1e-9
    name = "rack_force_estimate_n"
    was, is_now = golden.values[name][left][both], now.values[name][right][both]
    figure, ((above,), (below,)) = figures.subplots(2, 1)
    above.plot(since_s, was, color="black", linewidth=1.0, label="golden")
    above.plot(since_s, is_now, color=figures.COLOURS[0], linewidth=0.8, label="now")
    above.set_ylabel("rack force in N")
    above.legend()
    below.plot(since_s, is_now - was, color=figures.COLOURS[0], linewidth=0.8)
    for sign in (1.0, -1.0):
        below.axhline(sign * tolerance_n, color="black", linewidth=0.6, linestyle="--")
    below.set_ylabel("now less golden, N")
    below.set_xlabel("s since the first estimate")
    figures.save(figure, path)
