"""The page in a real browser (headless Chromium), on made-up samples; nothing depends on speed.

Where Chromium is missing these tests are skipped with a reason; EPS_HIL_REQUIRE_CHROMIUM=1 forbids
that (.ci/run sets it).
"""

import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from eps_hil.dashboard.listener import STATE, Outlet
from eps_hil.dashboard.store import Block, Store

pytestmark = [pytest.mark.slow, pytest.mark.chromium, pytest.mark.timeout(600)]
Blocks = Callable[[float, float], dict[str, Block]]
Make = Callable[..., Any]
STRIPS, LOOPS = 6, 2
READING = """() => document.querySelector('#readings tr:nth-child(3) td:nth-child(2)')
  ?.textContent.replace('−', '-')"""
PAINTED = """() => [...document.querySelectorAll('.plot canvas')].map(canvas => {
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let coloured = 0;
  for (let k = 0; k < data.length; k += 4)
    if (data[k + 3] > 100 && Math.max(data[k], data[k + 1], data[k + 2])
        - Math.min(data[k], data[k + 1], data[k + 2]) > 60) coloured++;
  return coloured; })"""


def state(**other: Any) -> dict[str, Any]:
    """Figures as the listener sends them."""
    return {
        "problems": [], "dropped": 0, "told": {},
        "bus": {"state": "error_active", "frames_per_s": 4260.0, "kbit_per_s": 525.0,
                "lost_by_counter": 0, "lost_in_kernel": 0, "crc_errors": 0, "error_frames": 0},
        "estimate": {"status": "valid", "reasons": "", "rack_force_n": 10.0, "age_ms": 22.0,
                     "rate_hz": 1000.0},
        "residual": {"rms_moving_n": 7.0, "rms_resting_n": None, "balance_n": 3.0, "why_not": ""},
        "limits": {"moving_n": 80.0, "resting_n": 228.0, "balance_n": 46.0},
        "signals": [{"name": "motor_speed_rad_s", "unit": "rad/s", "value": 1.0, "rate_hz": 1000.0,
                     "verdict": "fine", "service": ""}],
        **other,
    }  # fmt: skip


class Live:
    """A live server, and the listener's end of it."""

    def __init__(self, running: Make, blocks: Blocks, **more: Any) -> None:
        self._end, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.server = running(listener=theirs, **more)
        self.outlet, self._blocks, self.at_s = Outlet(self._end), blocks, 0.0

    def go_on(self, seconds: float) -> None:
        self.outlet.samples(self._blocks(self.at_s, self.at_s + seconds))
        self.at_s += seconds
        while self.outlet._pending:
            self.outlet.flush()

    def say(self, **other: Any) -> None:
        self._end.setblocking(True)
        self._end.send(STATE + json.dumps(state(**other)).encode())

    def close(self) -> None:
        self._end.close()


@pytest.fixture
def live(running: Make, blocks: Blocks, tmp_path: Path) -> Iterator[Live]:
    made = Live(running, blocks, marks=tmp_path / "bus.log.marks.jsonl")
    yield made
    made.close()


def newest(page: Any, value: float) -> None:
    """Wait until the reading of the newest estimate is ``value``, as near as a pixel is."""
    page.wait_for_function(f"Math.abs(({READING})() - {value}) < 0.02")


def test_it_draws_what_comes_and_tells_the_state(live: Live, open_page: Make) -> None:
    page = open_page(live.server.url)
    live.go_on(12.5)  # sin(2 pi 0.5 t) is 1 at 12.5 s
    live.say(told={"EPSHIL_OverrideState": {"age_s": 0.1, "values": {"State": "armed"}}})
    newest(page, 1.0)
    page.wait_for_function(f"({PAINTED})().every(coloured => coloured > 200)")
    assert len(page.evaluate(PAINTED)) == STRIPS + LOOPS
    page.wait_for_selector("#verdict.good")
    assert page.inner_text("#told") == "OverrideState\nstate\narmed"
    live.go_on(1.0)
    newest(page, -1.0)
    live.say(estimate=state()["estimate"] | {"status": "invalid", "reasons": "gap"},
             problems=["estimate invalid: gap"])  # fmt: skip
    page.wait_for_selector("#verdict.bad")
    assert page.inner_text("#problems") == "estimate invalid: gap"


def test_waiting_and_failing_are_said_in_words(live: Live, open_page: Make) -> None:
    page = open_page(live.server.url, eval_=False)
    live.say(problems=["waiting for frames of EPS_Torques (id 0x101) on can0; is the rig there?"])
    page.wait_for_selector("text=waiting for frames of EPS_Torques")
    assert page.inner_text("#told") == "nothing from the service or the ECU yet"
    page.wait_for_selector("#events .bad:has-text('since')")
    assert page.title().startswith("! ")
    live.say(dropped=7)
    page.wait_for_selector("#figures dd.bad:has-text('7 pieces of 40 ms did not reach this page')")
    page.wait_for_selector("#events li:not(.bad):has-text('s: waiting for frames')")
    assert not page.title().startswith("!")
    live.close()
    page.wait_for_selector("text=the listener on the bus has ended")
    live.server.end()
    page.wait_for_selector("text=no connection to eps-hil dashboard")


def test_the_last_verdict_does_not_stay_when_nothing_more_is_heard(
    live: Live, open_page: Make
) -> None:
    page = open_page(live.server.url, eval_=False)
    live.say()
    page.wait_for_selector("#verdict.good")
    page.wait_for_selector("#link.bad:has-text('no news for')")
    assert page.inner_text("#verdict.bad") == "estimate unknown"
    live.say()
    page.wait_for_selector("#verdict.good")
    page.wait_for_selector("#link.good")


def test_how_far_a_calibration_and_a_programme_are(live: Live, open_page: Make) -> None:
    page = open_page(live.server.url)
    gates = [
        {"name": "vehicle_speed", "met": True, "value": 0.1, "unit": "m/s", "limit": 1.0},
        {"name": "rack_force", "met": False, "value": None, "unit": "N", "limit": 50.0},
    ]
    live.say(waiting=["the service loads its code"], jobs=[
        {"kind": "calibration", "title": "torque injection", "text": "ramp +0.1 Nm  2/6", "done": 2,
         "of": 6, "gates": gates},
        {"kind": "programme", "title": "map.yaml", "text": "cell 3 of 40: settling", "done": 2,
         "of": 40},
    ])  # fmt: skip
    page.wait_for_selector("#jobs:not([hidden])")
    said = page.inner_text("#jobs")
    for text in ("Calibration: torque injection", "ramp +0.1 Nm  2/6", "gate: vehicle speed",
                 "limit 50", "not met", "Programme: map.yaml", "cell 3 of 40"):  # fmt: skip
        assert " ".join(text.split()) in " ".join(said.split()), text
    bars = page.eval_on_selector_all("#jobs progress", "all => all.map(o => [o.value, o.max])")
    assert bars == [[2, 6], [2, 40]]
    assert page.locator("#jobs .bad").all_inner_texts() == ["not met"]
    assert page.inner_text("#waiting") == "the service loads its code"
    live.say()
    page.wait_for_selector("#jobs", state="hidden")
    assert page.inner_text("#waiting") == ""


def test_freeze_zoom_cursors_and_going_on(live: Live, open_page: Make) -> None:
    page = open_page(live.server.url)
    live.go_on(12.5)
    newest(page, 1.0)
    page.keyboard.press(" ")
    page.wait_for_selector("#freeze[aria-pressed=true]")
    assert page.inner_text("#link.bad") == "frozen", "what stands still does not look live"
    live.go_on(1.0)
    box = page.locator(".u-over").first.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.25 * box["width"], middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], middle, steps=5)
    page.mouse.up()
    page.wait_for_function("Math.abs(document.documentElement.dataset.seconds - 5.0) < 0.1")
    page.mouse.click(box["x"] + 0.3 * box["width"], middle)
    page.keyboard.down("Shift")
    page.mouse.click(box["x"] + 0.6 * box["width"], middle)
    page.keyboard.up("Shift")
    page.wait_for_function(
        "document.querySelector('#readings tr').innerText.split('\\t').join('|') === "
        "'|newest|A|B|B − A'"
    )
    (between,) = page.eval_on_selector_all(
        "#readings tr:nth-child(2) td:nth-child(5)", "all => all.map(one => one.innerText)"
    )
    assert float(between.removesuffix(" s")) == pytest.approx(0.3 * 0.5 * 10.0, abs=0.1)
    assert float(page.evaluate(READING)) > -0.5, "what is frozen does not move on to -1"
    page.keyboard.press("Escape")
    page.keyboard.press(" ")
    newest(page, -1.0)
    page.keyboard.press("+")
    page.wait_for_selector("#freeze[aria-pressed=true]")


def test_a_hidden_page_is_given_no_more_than_two_messages(live: Live, open_page: Make) -> None:
    """One that draws nothing says so by saying nothing; when it draws again it has all of it."""
    page = open_page(live.server.url)
    live.go_on(12.5)
    newest(page, 1.0)
    page.evaluate("window.kept = requestAnimationFrame; window.requestAnimationFrame = f => "
                  "{ window.next = f; return 0; }")  # fmt: skip
    page.wait_for_function("window.next !== undefined")
    for _ in range(10):
        live.go_on(0.1)
    before = page.evaluate("document.documentElement.dataset.drawn")
    page.evaluate("() => new Promise(done => setTimeout(done, 300))")
    assert page.evaluate("document.documentElement.dataset.drawn") == before
    page.evaluate("window.requestAnimationFrame = window.kept; window.kept(window.next)")
    newest(page, -1.0)


def test_a_mark_goes_into_the_file_beside_the_recording(
    live: Live, open_page: Make, tmp_path: Path
) -> None:
    page = open_page(live.server.url)
    live.go_on(12.5)
    newest(page, 1.0)
    page.keyboard.press("m")
    page.keyboard.type("hit the <b>stop</b>")
    page.keyboard.press("Enter")
    page.wait_for_selector("#marks li")
    assert "hit the <b>stop</b>" in page.inner_text("#marks")
    (line,) = (tmp_path / "bus.log.marks.jsonl").read_text().splitlines()
    mark = json.loads(line)
    assert mark["text"] == "hit the <b>stop</b>"
    assert mark["t_ns"] * 1e-9 == pytest.approx(1_790_000_012.5, abs=0.05)
    assert "bus.log.marks.jsonl" in page.inner_text("#marks-where")


def test_what_is_seen_is_exported(live: Live, open_page: Make) -> None:
    page = open_page(live.server.url)
    live.go_on(12.5)
    newest(page, 1.0)
    with page.expect_download() as waiting:
        page.keyboard.press("e")
    lines = Path(waiting.value.path()).read_text().splitlines()
    assert lines[0].startswith("time_s,rack_force_estimate_n,")
    assert 9_900 < len(lines) <= 10_002  # the window of 10 s at 1 kHz
    assert float(lines[-1].split(",")[1]) == pytest.approx(1.0, abs=0.01)


def test_a_recording_with_a_time_slider(running: Make, blocks: Blocks, open_page: Make) -> None:
    store = Store()
    store.append(blocks(0.0, 40.0))
    page = open_page(running(store, recording="bus.log").url)
    page.wait_for_function(f"({PAINTED})().every(coloured => coloured > 200)")
    page.wait_for_selector("#time:not([hidden])")
    assert page.inner_text("#at").endswith("of 40 s")
    page.fill("#slider", "20.5")
    page.wait_for_function("document.querySelector('#at').textContent.startsWith('20.5 s')")
    newest(page, 1.0)  # 30.5 s is the newest that is shown
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    page.wait_for_function("document.querySelector('#at').textContent.startsWith('23.0 s')")
    assert page.is_hidden("#freeze")
    assert page.is_hidden("#told-card")


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_the_systems_scheme_a_switch_and_what_was_chosen_last(
    live: Live, open_page: Make, scheme: str
) -> None:
    page = open_page(live.server.url, scheme=scheme)
    other = "light" if scheme == "dark" else "dark"
    current = "document.documentElement.dataset.theme"
    assert page.evaluate(current) == scheme
    page.wait_for_selector("#link.good")
    page.keyboard.press("t")
    page.wait_for_function(f"{current} === '{other}'")
    page.reload()
    assert page.evaluate(current) == other


@pytest.mark.parametrize("width", [360, 500, 820, 1366, 3840])
def test_no_window_is_too_narrow_or_too_wide(live: Live, open_page: Make, width: int) -> None:
    page = open_page(live.server.url, width=width)
    live.go_on(2.5)
    live.say()
    newest(page, 1.0)
    page.wait_for_selector("#verdict.good")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    tools = page.eval_on_selector_all(
        "#tools button", "all => all.map(one => one.getBoundingClientRect().right)"
    )
    assert max(tools) <= width
    words = page.eval_on_selector_all(
        "h1, h2, p, dt, dd, td, li, .key, button",
        "all => all.map(one => parseFloat(getComputedStyle(one).fontSize))",
    )
    read_from_afar = 22.0 if width > 2800 else 11.0
    assert min(words) >= read_from_afar


def test_everything_can_be_reached_and_read_by_keyboard(live: Live, open_page: Make) -> None:
    page = open_page(live.server.url)
    page.wait_for_selector("#link.good")
    reached = []
    for _ in range(8):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id"))
    assert reached[:7] == ["freeze", "length", "whole", "mark", "export", "theme", "help"]
    page.keyboard.press("?")
    page.wait_for_selector("#keys[open]")
    page.keyboard.press("Escape")
    page.wait_for_selector("#keys:not([open])", state="attached")
