"""The running diagnosis in a real browser; a small script stands for the process that diagnoses."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.dashboard import diagnosis
from eps_hil.dashboard.diagnosis import Subject
from eps_hil.dashboard.store import Block, Store
from eps_hil.dashboard.traces import BALANCE, CELL, SPEED

pytestmark = [pytest.mark.slow, pytest.mark.chromium, pytest.mark.timeout(600)]
Blocks = Callable[[float, float], dict[str, Block]]
Make = Callable[..., Any]
T0_NS = 1_790_000_000_000_000_000
FOUND = {
    "verdict": "The mismatch is explained by Stribeck friction.", "kind": "explained",
    "findings": [{
        "effect": "stribeck", "title": "Stribeck friction", "summary": "More <b>friction</b>.",
        "confidence": 0.97, "values": [{"name": "level nm", "text": "0.052 ± 0.003 Nm"}],
        "size": "60 N rms at the rack", "confusable_with": [],
        "frame": {"motor_speed_rad_s": [-10.0, 10.0]},
    }],
    "gain": [{"name": "torque_nrmse", "title": "NRMSE of the torque residual", "unit": "",
              "before": 0.21, "after": 0.02, "floor": 0.019}],
    "map": {"x": [-40.0, 40.0], "y": [-100.0, 100.0], "cells": 16, "top_n": 60.0,
            "before": [[k % 16, k // 16, 60.0 if 6 <= k % 16 <= 9 else 5.0, 90]
                       for k in range(256)],
            "after": [[k % 16, k // 16, 5.0, 90] for k in range(256)]},
    "strip": {"window_s": 0.5,
              "before": [[T0_NS * 1e-9 + 10 + 0.5 * k, 40.0] for k in range(40)],
              "after": [[T0_NS * 1e-9 + 10 + 0.5 * k, 5.0] for k in range(40)]},
    "kept_from_s": 13.0, "segments": [[2.0, 4.0, 0.4]], "limits": ["a note"],
    "start_s": T0_NS * 1e-9 + 10.0,
}  # fmt: skip
GATED = """
import json, os, sys, time
order = json.loads(sys.stdin.readline())
print(json.dumps({"stage": "looking for effects", "part": 0.4}), flush=True)
while not os.path.exists(GATE):
    time.sleep(0.02)
json.dump(FOUND, open(order["folder"] + "/result.json", "w"))
open(order["folder"] + "/page.html", "w").write(
    "<!doctype html><title>report</title><script>document.title = 'drawn'</script>"
    "<p>" + str(order["end_ns"] - order["begin_ns"]) + "</p>")
print(json.dumps({"done": True}), flush=True)
"""
COLOURS = """id => { const canvas = document.getElementById(id);
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  let yellow = 0, blue = 0;
  for (let k = 0; k < data.length; k += 4) {
    if (data[k] > 230 && data[k + 1] > 210 && data[k + 2] < 90) yellow++;
    if (data[k] < 40 && data[k + 1] < 60 && data[k + 2] > 60) blue++;
  } return [yellow, blue]; }"""


@pytest.fixture
def gate(tmp_path: Path) -> Path:
    return tmp_path / "gate"


@pytest.fixture
def page(
    running: Make, open_page: Make, blocks: Blocks, gate: Path, monkeypatch: pytest.MonkeyPatch
) -> Any:
    script = f"GATE = {str(gate)!r}\nFOUND = {FOUND!r}\n{GATED}"
    monkeypatch.setattr(diagnosis, "COMMAND", (sys.executable, "-c", script))
    store = Store()
    made = blocks(0.0, 40.0)
    t_ns, wave = made["motor_torque_nm"]
    speed = 10.0 * wave
    left = np.where(np.abs(speed) < 10.0, 30.0, 3.0)
    store.append({**made, SPEED: (t_ns, speed), CELL: (t_ns, 20.0 * wave),
                  BALANCE: (t_ns[::8], left[::8])})  # fmt: skip
    subject = Subject(Path("m.yaml"), recording=Path("bus.log"), limit_n=20.0)
    return open_page(running(store, recording="bus.log", subject=subject).url)


def test_where_rig_and_model_part_is_drawn(page: Any) -> None:
    page.wait_for_selector("#mismatch-drawn:not([hidden])")
    page.wait_for_function(f"({COLOURS})('mismatch-map')[0] > 300")
    assert page.inner_text("#scale-top") == "30 N rms"
    assert page.evaluate(f"({COLOURS})('mismatch-map')")[1] > 300, "little at high speed"
    assert "more than 20 N" in page.inner_text("#mismatch-what")
    assert page.inner_text("#diagnose") == "Diagnose all that is kept, 40 s"
    page.locator("#mismatch-map").scroll_into_view_if_needed()
    box = page.locator("#mismatch-map").bounding_box()
    right = 62 + 8.5 / 16 * (box["width"] - 78)  # the cell right of and above the middle
    page.mouse.move(box["x"] + right, box["y"] + 8 + 7.5 / 16 * (box["height"] - 46))
    page.wait_for_function("/30 N rms/.test(document.getElementById('mismatch-says').textContent)")


def test_a_marked_stretch_is_diagnosed_and_shown_where_it_was(page: Any, gate: Path) -> None:
    page.wait_for_selector("#mismatch-drawn:not([hidden])")
    page.locator("#mismatch-strip").scroll_into_view_if_needed()
    box = page.locator("#mismatch-strip").bounding_box()
    width, y = box["width"] - 78, box["y"] + 15
    page.mouse.move(box["x"] + 62 + 0.25 * width, y)
    page.mouse.down()
    page.mouse.move(box["x"] + 62 + 0.75 * width, y, steps=4)
    page.mouse.up()
    assert page.inner_text("#diagnose") == "Diagnose what is marked, 20 s"
    page.keyboard.press("d")
    page.wait_for_selector("#diagnose-progress:not([hidden])")
    page.wait_for_function("document.getElementById('diagnose-progress').value === 0.4")
    assert page.inner_text("#diagnose-said").startswith("looking for effects")
    assert page.is_disabled("#diagnose")
    gate.touch()
    page.wait_for_selector(".found")
    said = page.inner_text(".found")
    for text in ("1 Stribeck friction (97 %)", "More <b>friction</b>.", "0.052 ± 0.003 Nm",
                 "60 N rms at the rack", "0.21", "0.02", "a note"):  # fmt: skip
        assert text in said or text in page.text_content(".found"), text
    assert page.get_attribute("#view-before", "aria-pressed") == "true"
    yellow, _ = page.evaluate(f"({COLOURS})('mismatch-map')")
    assert yellow > 300
    page.click("#view-after")
    page.wait_for_function(f"({COLOURS})('mismatch-map')[0] === 0")
    with page.expect_popup() as opened:
        page.click("text=the whole report")
    report = opened.value
    report.wait_for_function("document.title === 'drawn'")
    assert float(report.inner_text("p")) == pytest.approx(20e9, rel=0.02)
    assert page.request.get(page.url + "diagnosis/7.html").status == 404


def test_a_diagnosis_is_cancelled_by_its_button(page: Any) -> None:
    page.wait_for_selector("#mismatch-drawn:not([hidden])")
    page.click("#diagnose")
    page.click("#diagnose-cancel")
    page.wait_for_function("document.getElementById('diagnose-said').textContent === 'cancelled'")
    assert page.is_enabled("#diagnose")
    assert page.is_hidden("#diagnose-progress")


def test_a_page_from_elsewhere_only_looks(
    running: Make, open_page: Make, monkeypatch: pytest.MonkeyPatch, blocks: Blocks
) -> None:
    from eps_hil.dashboard.server import Hub

    monkeypatch.setattr(Hub, "may_diagnose", lambda *_: False)
    store = Store()
    store.append(blocks(0.0, 40.0))
    page = open_page(running(store, recording="bus.log", subject=Subject(Path("m.yaml"))).url)
    page.wait_for_selector("#mismatch-drawn:not([hidden])")
    assert page.is_disabled("#diagnose")
    page.evaluate(
        "() => { const feed = new WebSocket(location.href.replace('http', 'ws') + 'feed');"
        " feed.onmessage = (event) => { window.heard = (window.heard || '') + event.data; };"
        " feed.onopen = () => { feed.send(JSON.stringify({diagnose: {from: 1790000000, to: "
        "1790000030}})); feed.send(JSON.stringify({mark: {t: 1790000001, text: 'after it'}})); } }"
    )
    page.wait_for_function("(window.heard || '').includes('after it')")
    assert '"running": null' in page.evaluate("window.heard")
    assert '"running": {' not in page.evaluate("window.heard")
