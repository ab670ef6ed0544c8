"""Notes on inputs that were not recorded all the time."""

from typing import Any

import numpy as np
import pytest

from eps_hil.recordings.coverage import invented
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
