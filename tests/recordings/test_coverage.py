"""Notes on inputs that were not recorded all the time."""

from typing import Any

import numpy as np
import pytest

from eps_hil.recordings.coverage import Gaps, gaps, in_words, invented
from eps_hil.series import Series

T_NS = np.arange(10_000, dtype=np.int64) * 1_000_000
DRIVER = "motor_torque_nm"
FORCE = "rack_force_n"


def series(kept: Any = slice(None), bad: Any = slice(0, 0)) -> Series:
    value = np.ones(len(T_NS))
    value[bad] = np.nan
    return Series(T_NS[kept], value[kept])


def hole() -> Any:
    return np.r_[0:3000, 4000:7000, 9000:10_000]


@pytest.mark.parametrize(
    ("one", "said"),
    [
        (series(), []),
        (series(slice(0, None, 50)), []),  # slower, and there to the end
        (series(bad=slice(None)), ["rack_force_n has no good sample: taken as zero"]),
        (
            series(slice(0, 5000)),
            ["rack_force_n ends 5 s before motor_torque_nm: from there on held at its last value"],
        ),
        (
            series(bad=slice(0, 2000)),
            [
                "rack_force_n: 2000 bad samples: drawn straight between the good ones",
                "rack_force_n begins 2 s after motor_torque_nm: until then held at its first value",
            ],
        ),
        (
            series(hole()),
            ["rack_force_n: 2 gaps, the longest of 2 s at 6.999 s: drawn straight"],
        ),
        (
            series(bad=slice(10, 12)),
            ["rack_force_n: 2 bad samples: drawn straight between the good ones"],
        ),
    ],
)
def test_what_is_invented_is_told(one: Series, said: list[str]) -> None:
    told = invented({DRIVER: series(), FORCE: one}, (DRIVER, "torque_sensor_nm", FORCE), DRIVER)
    assert told == said


def test_the_driver_itself_may_have_holes() -> None:
    driver = series(hole(), bad=slice(0, 5))
    told = invented({DRIVER: driver}, (DRIVER,), DRIVER)
    assert told == [
        "motor_torque_nm: 5 bad samples: drawn straight between the good ones",
        "motor_torque_nm: 2 gaps, the longest of 2 s at 6.999 s: drawn straight",
    ]


def test_gaps_are_counted_from_the_recordings_begin() -> None:
    later = series(slice(1000, None))
    found = gaps(
        {
            DRIVER: series(hole()), FORCE: series(hole()), "motor_speed_rad_s": later,
            "motor_angle_rad": series(bad=slice(500, 650)), "torque_sensor_nm": series(slice(1)),
        },
        (DRIVER, "motor_speed_rad_s", "motor_angle_rad", FORCE, "torque_sensor_nm", "x"),
    )  # fmt: skip
    assert found == {
        DRIVER: Gaps(2, 2.001, 6.999),
        "motor_angle_rad": Gaps(1, 0.151, 0.499),
        FORCE: Gaps(2, 2.001, 6.999),
    }
    assert in_words(found) == [
        "motor_torque_nm, rack_force_n: 2 gaps, the longest of 2 s at 6.999 s",
        "motor_angle_rad: 1 gap of 0.151 s at 0.499 s",
    ]
    slow = series(slice(0, None, 50))  # one step more is no gap
    assert gaps({DRIVER: Series(np.delete(slow.t_ns, 9), slow.value[1:])}, (DRIVER,)) == {}
