"""Two channels: the same frames are found however far apart, or it is said why not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from eps_hil.clocks.audit import audit
from eps_hil.clocks.between import between
from eps_hil.clocks.corrected import corrected_stamps
from eps_hil.clocks.payloads import Payloads
from eps_hil.clocks.stamps import Channel, Message

Write = Callable[..., Path]
EPOCH = 1.7e9


def clock(
    offset_s: float, ppm: float = 0.0, step_s: float = 0.0, at_s: float = 20.0
) -> Callable[[np.ndarray], np.ndarray]:
    return lambda t: EPOCH + offset_s + t * (1.0 + 1e-6 * ppm) + step_s * (t > at_s)


@pytest.mark.parametrize("payload", ["counter", "constant"])
@pytest.mark.parametrize("periods", [(1e-3,), (1e-3, 1e-2, 2e-2)])
def test_payloads_that_repeat_are_said_to_be_ambiguous_and_correct_nothing(
    write_senders: Write, payload: str, periods: tuple[float, ...]
) -> None:
    log = write_senders({"can0": clock(0.0), "can1": clock(37.1e-3)}, payload, periods)
    found = audit(log)
    assert found.pairs == ()
    (untied,) = found.untied
    assert untied.why.startswith("payloads repeat: ")
    if payload == "counter":  # 16 cycles of the slowest message
        apart = {1: "16.0 ms", 3: "320.0 ms"}[len(periods)]
        assert f"{apart} and more from it" in untied.why
    if (payload, len(periods)) == ("counter", 3):
        assert "37.1 ms fits" in untied.why
    for one in found.channels:
        assert one.steps == ()
        assert np.array_equal(corrected_stamps(found)[one.channel.name], one.channel.t_ns)


def test_a_log_that_a_payload_repeats_in_once_is_ambiguous_too(write_senders: Write) -> None:
    # in its middle each payload is alone: there is no frame 20 s before or after
    clocks = {"can0": clock(0.0), "can1": clock(37.1e-3)}
    found = audit(write_senders(clocks, "wraps", (1e-2,)))
    assert found.pairs == ()
    assert "37.1 ms fits, and so do others, 20.00" in found.untied[0].why


@pytest.mark.parametrize("offset_s", [0.6, -70.0, 12.3 - EPOCH])
def test_clocks_far_apart_are_compared(write_senders: Write, offset_s: float) -> None:
    found = audit(write_senders({"can0": clock(0.0), "can1": clock(offset_s, ppm=10.0)}))
    (pair,) = found.pairs
    sign = 1.0 if pair.channel == "can1" else -1.0
    assert sign * pair.offset_s == pytest.approx(offset_s, abs=1e-5)
    assert sign * pair.drift_ppm == pytest.approx(10.0, abs=0.2)
    stamps = corrected_stamps(found)
    assert abs(np.median(stamps["can0"] - stamps["can1"])) < 5_000


@pytest.mark.parametrize("on", ["can0", "can1"])
@pytest.mark.parametrize("step_s", [2.3e-3, 0.5, -0.7])
def test_the_other_channel_tells_whose_step_it_is(
    write_senders: Write, on: str, step_s: float
) -> None:
    clocks = {name: clock(0.01, step_s=step_s if name == on else 0.0) for name in ("can0", "can1")}
    found = audit(write_senders(clocks, periods=(1e-3,)))
    for one in found.channels:
        assert one.slipped == ()
        assert one.silences == ()
        sizes = [step.by_s for step in one.steps]
        assert sizes == pytest.approx([step_s] if one.channel.name == on else [], abs=1e-5)
    stamps = corrected_stamps(found)
    assert np.quantile(np.abs(stamps["can0"] - stamps["can1"]), 0.999) < 1e6


def test_silence_on_one_channel_alone_is_loss(write_senders: Write) -> None:
    both = write_senders({"can0": clock(0.0), "can1": clock(0.01)}, "rare", (1e-3, 1e-2))
    lines = both.read_text().splitlines(keepends=True)
    kept = [ln for ln in lines if not (" can1 " in ln and EPOCH + 9 < float(ln[1:18]) < EPOCH + 10)]
    # without the bytes that count
    rng = np.random.default_rng(4)
    names = {f"{k:08x}": f"{int(rng.integers(2**32)):08x}" for k in range(30_000)}
    both.write_text("".join(ln[:-9] + names[ln[-9:-1]] + "\n" for ln in kept))
    found = audit(both)
    assert all(one.silences == () and one.steps == () for one in found.channels)
    assert not found.pairs[0].line.steps


def long(name: str, clock_ns: Callable[[np.ndarray], np.ndarray], seconds: int) -> Channel:
    k = np.arange(1000 * seconds, dtype=np.int64)
    rng = np.random.default_rng(len(name))
    t_ns = clock_ns(k * 1_000_000 + rng.exponential(5e4, len(k)).astype(np.int64))
    data = Payloads.of([int(one).to_bytes(4, "little") for one in k])
    return Channel(name, t_ns, (Message(name, 0x100, False, t_ns, data, k),))


def test_a_step_is_found_late_in_a_long_log() -> None:
    late_ns = 250_900_000_000
    found = between(
        long("can1", lambda t: t + 2_300_000 * (t > late_ns), 300), long("can", lambda t: t, 300)
    )
    assert not hasattr(found, "why")
    (step,) = found.line.steps
    assert step.by_s == pytest.approx(2.3e-3, abs=5e-6)
    assert step.at_s == pytest.approx(250.9, abs=0.01)


def test_channels_without_a_frame_in_common_say_so(write_senders: Write) -> None:
    log = write_senders({"can0": clock(0.0), "can1": clock(0.0)}, periods=(1e-2,))
    text = "".join(
        line.replace("can1 100", "can1 200") for line in log.read_text().splitlines(keepends=True)
    )
    log.write_text(text)
    (untied,) = audit(log).untied
    assert untied.why.startswith("fewer than 50 frames in common")
