"""Steps of one channel's clock: found to the frame, told from losses, taken out of the copy."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from eps_hil.clocks.audit import ChannelAudit, audit, judged
from eps_hil.clocks.corrected import corrected_stamps, write_corrected
from eps_hil.clocks.jumps import Jump
from eps_hil.clocks.stamps import read_channels
from eps_hil.errors import InputError

Write = Callable[..., Path]
AT_S = 15.123


def stepping(by_s: float, at_s: float = AT_S) -> Callable[[np.ndarray], np.ndarray]:
    return lambda t: 1e3 + t + by_s * (t > at_s)


def only(path: Path) -> ChannelAudit:
    (channel,) = audit(path).channels
    return channel


def lost(channel: ChannelAudit) -> list[int]:
    return [told.lost for _, told in channel.messages if told is not None]


@pytest.mark.parametrize("by_s", [2.3e-3, 20.3e-3, -20.3e-3, -0.1, -2.5003, 0.25, 3.0003])
def test_a_step_is_found_whatever_its_size_and_no_cycle_is_lost(
    write_senders: Write, tmp_path: Path, by_s: float
) -> None:
    path = write_senders({"can0": stepping(by_s)})
    found = audit(path)
    (channel,) = found.channels
    (step,) = channel.steps
    assert step.by_s == pytest.approx(by_s, abs=5e-6)
    assert step.at_s == pytest.approx(AT_S, abs=2e-3)
    assert lost(channel) == [0, 0, 0]
    assert channel.slipped == ()
    assert channel.silences == ()
    assert channel.went_back == (0, 0)
    for (_, told), ppm in zip(channel.messages, (80.0, -40.0, 10.0), strict=True):
        assert told is not None
        assert told.drift_ppm == pytest.approx(ppm, abs=0.3)
    whole = corrected_stamps(audit(write_senders({"can0": stepping(0.0)})))["can0"]
    assert np.max(np.abs(corrected_stamps(found)["can0"] - whole)) < 10_000


@pytest.mark.parametrize("by_s", [-0.1, -2.5003, 0.26])
def test_the_copy_keeps_the_order_of_the_frames(
    write_senders: Write, tmp_path: Path, by_s: float
) -> None:
    path = write_senders({"can0": stepping(by_s)})
    write_corrected(audit(path), tmp_path / "copy.log")
    told = [[line.upper().split()[2] for line in p.read_text().splitlines()]
            for p in (path, tmp_path / "copy.log")]  # fmt: skip
    assert told[0] == told[1]
    assert only(tmp_path / "copy.log").steps == ()


def test_counters_tell_a_step_of_whole_cycles_from_lost_cycles(write_senders: Write) -> None:
    (step,) = only(write_senders({"can0": stepping(0.26)}, "counter")).steps
    assert step.by_s == pytest.approx(0.26, abs=5e-6)
    silent = only(write_senders({"can0": stepping(0.0)}, "counter", silent=(AT_S, 0.26)))
    assert (silent.steps, silent.silences) == ((), ())
    assert lost(silent) == pytest.approx([260, 26, 13], abs=1)


@pytest.mark.parametrize(("by_s", "silent"), [(0.26, (0.0, 0.0)), (0.0, (AT_S, 0.26))])
def test_without_counters_a_step_of_whole_cycles_and_silence_are_one(
    write_senders: Write, by_s: float, silent: tuple[float, float]
) -> None:
    channel = only(write_senders({"can0": stepping(by_s)}, "constant", silent=silent))
    assert channel.steps == ()
    (silence,) = channel.silences
    assert silence.for_s == pytest.approx(by_s + silent[1], abs=2e-3)
    assert silence.at_s == pytest.approx(AT_S, abs=5e-3)


def test_after_a_long_silence_the_senders_quartzes_tell_that_frames_were_lost(
    write_senders: Write,
) -> None:
    channel = only(write_senders({"can0": stepping(0.0)}, "constant", silent=(AT_S, 6.0)))
    assert (channel.steps, channel.silences) == ((), ())
    assert lost(channel) == pytest.approx([6000, 600, 300], abs=1)


def test_a_forward_step_without_counters_says_how_much_losses_would_change(
    write_senders: Write,
) -> None:
    channel = only(write_senders({"can0": stepping(20.3e-3)}, "constant"))
    (jump,) = channel.jumps
    assert jump.by_s == pytest.approx(20.3e-3, abs=5e-6)
    assert jump.or_less_s == pytest.approx(20e-3, abs=1e-4)
    (back,) = only(write_senders({"can0": stepping(-20.3e-3)}, "constant")).jumps
    assert back.or_less_s is None  # no loss turns a clock back


def test_several_steps_both_ways_and_one_too_small_for_single_frames(
    write_senders: Write,
) -> None:
    def clock(t: np.ndarray) -> np.ndarray:
        late = 13.1e-3 * (t > 7.0) - 0.1 * (t > 9.0) + 2e-4 * (t > 20.3)
        return np.asarray(1e3 + t + late)

    found = audit(write_senders({"can0": clock}))
    steps = found.channels[0].steps
    assert [one.by_s for one in steps] == pytest.approx([13.1e-3, -0.1, 2e-4], abs=1e-5)
    assert [one.at_s for one in steps] == pytest.approx([7.0, 9.013, 20.213], abs=0.01)
    whole = corrected_stamps(audit(write_senders({"can0": stepping(0.0)})))["can0"]
    assert np.sum(np.abs(corrected_stamps(found)["can0"] - whole) > 100_000) < 10


@pytest.mark.parametrize("payload", ["counter", "constant"])
def test_bursts_after_stalls_are_no_steps(write_senders: Write, payload: str) -> None:
    def clock(t: np.ndarray) -> np.ndarray:
        for start, stop in ((8.0, 8.05), (12.0, 12.031), (13.0, 13.012), (20.0, 20.25)):
            t = np.where((t > start) & (t < stop), stop + 1e-2 * (t - start), t)
        return np.asarray(1e3 + t)

    channel = only(write_senders({"can0": clock}, payload))
    assert (channel.steps, channel.slipped, channel.silences) == ((), (), ())
    assert lost(channel) == [0, 0, 0]


def test_a_step_amid_late_frames_is_compared_modulo_each_messages_cycle(
    write_senders: Write,
) -> None:
    # too small to stand out of single intervals; 3.3 ms are 1.7 ms early for a cycle of 5 ms
    channel = only(
        write_senders({"can0": stepping(3.3e-3)}, periods=(5e-3, 1e-2, 2e-2), late_s=5e-4)
    )
    (step,) = channel.steps
    assert step.by_s == pytest.approx(3.3e-3, abs=5e-5)
    assert channel.slipped == ()
    assert channel.jumps == ()


def test_a_frame_that_stands_out_of_order_stays_there(write_senders: Write, tmp_path: Path) -> None:
    path = write_senders({"can0": stepping(-0.1)}, periods=(1e-2, 2e-2))
    lines = path.read_text().splitlines(keepends=True)
    lines[50:52] = lines[51:49:-1]
    path.write_text("".join(lines))
    found = audit(path)
    assert found.channels[0].went_back[0] == 1
    write_corrected(found, tmp_path / "copy.log")
    copy = (tmp_path / "copy.log").read_text().upper().splitlines()
    assert [line.split()[2] for line in copy] == [line.upper().split()[2] for line in lines]


def test_a_jump_that_the_rest_of_the_log_does_not_show_is_none(write_senders: Write) -> None:
    (channel,) = read_channels(write_senders({"can0": stepping(0.0)}))
    for by_s in (1e-4, -7e-4):
        jump = Jump(frame=9_000, at_s=8.0, by_s=by_s, sigma_s=1e-5)
        assert judged(channel, [jump], ()).steps == ()


def test_one_message_shows_a_step_back_and_cannot_tell_a_pause_from_one_forward(
    write_senders: Write,
) -> None:
    (step,) = only(write_senders({"can0": stepping(-1.5)}, periods=(1e-3,))).steps
    assert step.by_s == pytest.approx(-1.5, abs=5e-6)
    forward = only(write_senders({"can0": stepping(0.5)}, periods=(1e-3,)))
    assert forward.steps == ()
    assert forward.silences[0].for_s == pytest.approx(0.5, abs=1e-3)


def test_a_clock_that_went_back_by_what_nobody_knows_is_not_copied(tmp_path: Path) -> None:
    path = tmp_path / "events.log"
    at_s = np.cumsum(np.random.default_rng(2).exponential(0.05, 400)) + 1e3
    at_s -= 5.0 * (np.arange(400) > 200)
    path.write_text("".join(f"({t:.6f}) can0 300#01\n" for t in at_s))
    with pytest.raises(InputError, match=r"clock of can0 goes back .* split the log there"):
        write_corrected(audit(path), tmp_path / "copy.log")
