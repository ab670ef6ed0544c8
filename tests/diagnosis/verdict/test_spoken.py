"""Places and times as a rig engineer says them."""

from eps_hil.diagnosis.accept.free_run import DISAGREE, worse_free_run
from eps_hil.diagnosis.accept.proof_of_fit import NOISES, still_left
from eps_hil.diagnosis.verdict.spoken import (
    all_clear,
    but,
    most_in_words,
    place_in_words,
    shares_in_words,
    when_in_words,
)
from eps_hil.investigate.story import showed


def test_a_place_has_a_plain_name_and_unit() -> None:
    place = {"signal": "rack_position_m", "from": -0.008, "to": 0.0125, "share_of_excess": 0.9}
    assert place_in_words(place) == "rack position -8 to 12.5 mm"
    place = {"signal": "dwell_s", "from": 0.008, "to": 0.032, "share_of_excess": 0.9}
    assert place_in_words(place) == "time at rest before it moved 0.008 to 0.032 s"
    assert place_in_words({"signal": "x|left", "from": 0, "to": 1}) == "x|left 0 to 1"


def test_a_share_is_told_beside_its_share_of_the_time() -> None:
    place = {"signal": "rack_force_n", "from": 100, "to": 900, "share_of_excess": 0.87}
    assert shares_in_words([place]) == ["87 % of it at rack force 100 to 900 N"]
    told = shares_in_words([{**place, "share_of_time": 0.12}])
    assert told == ["87 % of it in 12 % of the time at rack force 100 to 900 N"]
    told = shares_in_words([{**place, "share_of_time": 0.002}], lambda _place: "the stops")
    assert told == ["87 % of it in under 1 % of the time at the stops"]
    told = shares_in_words([{**place, "share_of_excess": 0.0}])
    assert told == ["at rack force 100 to 900 N"]
    assert shares_in_words([]) == []


def test_what_is_spread_evenly_is_told_once() -> None:
    evenly = "87 % of it in 85 % of the time: hardly more at one {} than at another"
    for signal, name in (
        ("rack_force_n", "rack force"), ("motor_speed_rad_s|left", "rotor speed"),
        ("abs_motor_speed_rad_s", "rotor speed"), ("x", "x"),
    ):  # fmt: skip
        place = {"signal": signal, "from": 1, "to": 9, "share_of_excess": 0.87}
        assert shares_in_words([{**place, "share_of_time": 0.85}]) == [evenly.format(name)]
    speed = {"signal": "motor_speed_rad_s"}
    down = {**speed, "from": -337, "to": -13.3, "share_of_excess": 0.5, "share_of_time": 0.26}
    up = {**speed, "from": 13.3, "to": 337, "share_of_excess": 0.36, "share_of_time": 0.27}
    assert shares_in_words([down, up]) == [
        "50 % of it in 26 % of the time at rotor speed -337 to -13.3 rad/s",
        "36 % of it in 27 % of the time at rotor speed 13.3 to 337 rad/s",
    ]
    down = {**down, "share_of_excess": 0.3}
    told = "66 % of it in 53 % of the time: hardly more at one rotor speed than at another"
    assert shares_in_words([{**down, "share_of_time": 0.3}, {**up, "share_of_time": 0.27}]) == [
        told.replace("53", "57")
    ]


def test_a_pair_of_signals_is_told_in_plain_words() -> None:
    cell = {"signals": ["rack_position_m", "abs_motor_speed_rad_s"], "from": [0.0, 2.0],
            "to": [0.01, 9.0], "share_of_excess": 0.4, "share_of_time": 0.05}  # fmt: skip
    assert most_in_words({"cells": [cell]}) == (
        "40 % of it in 5 % of the time: rack position 0 to 10 mm and rotor speed of either sign "
        "2 to 9 rad/s"
    )
    assert most_in_words({}) == ""


def test_one_recording_that_holds_it_all_is_named() -> None:
    def part(name: str, share: float) -> dict[str, object]:
        return {"recording": name, "from_s": 3.0, "to_s": 9.5, "share_of_excess": share}

    def shares(a: float, time: float) -> list[dict[str, object]]:
        return [
            {"recording": "a", "share_of_excess": a, "share_of_time": time},
            {"recording": "b", "share_of_excess": 1 - a, "share_of_time": 1 - time},
        ]

    assert when_in_words([]) == ""
    assert when_in_words([part("a", 0.4)], shares(0.97, 0.5)) == "only in a"
    assert when_in_words([], shares(0.7, 0.4)) == "70 % of it in a (40 % of the time)"
    assert when_in_words([], shares(0.7, 0.65)) == ""
    assert when_in_words([part("a", 0.4)], shares(0.5, 0.5)) == ""
    assert when_in_words([part("a", 0.6)]) == "60 % of it from 3.0 to 9.5 s"
    assert when_in_words([part("b", 0.6)], shares(0.02, 0.5)) == (
        "only in b; 60 % of it from 3.0 to 9.5 s of b"
    )


def test_what_is_clearly_more_than_noise_is_never_called_sensor_noise() -> None:
    (kept,) = still_left(
        {"augmented": {"torque_nrmse": 0.03}, "noise_floor": {"torque_nrmse": 0.01}}
    )
    assert all_clear([]).startswith("Nothing is missing: what differs is sensor noise")
    assert "could show" in all_clear(["no steering-wheel angle was recorded"])
    assert all_clear([kept]).endswith("and it is more than sensor noise")


def test_an_investigation_says_so_too() -> None:
    told = {"problem": "", "verdict": "no_mismatch", "findings": [], "limits": []}
    assert showed(told) == "nothing is missing"
    more = {**told, "limits": [f"At rest 12 {NOISES} in a right model"]}
    assert showed(more) == "no effect of the catalogue explains what differs"


def test_an_explanation_that_makes_a_free_run_worse_says_so_in_its_words() -> None:
    told = {"torque_nrmse": 0.3, "speed_fit_percent": 60.0}
    worse = worse_free_run(
        {"baseline": told, "augmented": {"torque_nrmse": 0.1, "speed_fit_percent": 53.0}}
    )
    assert "free simulation is worse" in but(worse)
    assert "sensor noise is left" in but([f"At rest 12 {NOISES} in a right model"])
    assert but([f"{DISAGREE}, by no more than the sensors' noise makes"]) == ""
    assert but([]) == ""
