"""Whether the rack position moves as the rotor turns: without it nobody holds a limit of travel.

A position that stands still, starts anew every turn or has the wrong sign passes for a rack that is
far from its limit, while the robot turns on and on.
"""

import math

from eps_hil.errors import SafetyStop
from eps_hil.programme.conductor import Reading

_MEMORY_S = 5.0
"""So an error of the speed's zero (a rig at rest reads less than 1 rad/s) does not add up."""
_SHARE, _MOST_M = 0.3, 3e-3
"""What may be missing of the way: a ratio that is not known well, late and slow messages."""
_PAUSE_S = 0.2


class Follows:
    """Way of the rack by its position against that by the rotor's speed, over the last seconds.

    ``ratio_rad_per_m``: i_APA, rotor over rack.
    """

    def __init__(self, ratio_rad_per_m: float) -> None:
        self._ratio = ratio_rad_per_m
        self._before: tuple[float, float] | None = None
        self._error_m = self._way_m = 0.0

    def check(self, reading: Reading, now_s: float) -> None:
        """Take the newest reading, at ``now_s`` of a steady clock.

        :class:`SafetyStop` where the position has not gone the rotor's way.
        """
        before, self._before = self._before, (now_s, reading.position_m)
        if before is None or now_s - before[0] > _PAUSE_S:
            self._error_m = self._way_m = 0.0
            return
        by_rotor_m = reading.speed_rad_s * (now_s - before[0]) / self._ratio
        moved_m = reading.position_m - before[1]
        if not math.isfinite(moved_m + by_rotor_m):
            return  # whoever leads refuses it
        kept = math.exp((before[0] - now_s) / _MEMORY_S)
        self._error_m = kept * self._error_m + moved_m - by_rotor_m
        self._way_m = kept * self._way_m + abs(by_rotor_m)
        if abs(self._error_m) > _MOST_M + _SHARE * self._way_m:
            raise SafetyStop(
                f"the rack position is {1e3 * abs(self._error_m):.1f} mm off the way that the "
                f"rotor turned ({1e3 * self._way_m:.1f} mm): it stands still, has another sign or "
                "unit, or starts anew every turn; the limits of travel cannot be held"
            )
