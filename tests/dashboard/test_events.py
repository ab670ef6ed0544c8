"""What was wrong is kept with its time, also for pages that were not open then."""

import json

from eps_hil.dashboard.events import MOST, Events
from eps_hil.dashboard.marks import Marks
from eps_hil.dashboard.server import About, Hub
from eps_hil.dashboard.store import Store

ALARM = "rig and model part, moving: {} N rms, limit 80 N"
SILENT = "nothing on id 0x120 (EPSHIL_Estimate) any more: the service has stopped sending"


def test_an_alarm_with_a_number_that_moves_is_one_event_and_ends() -> None:
    events = Events()
    for k, rms in enumerate((90, 120, 101.5)):
        events.see(100.0 + k, [ALARM.format(rms)])
    events.see(103.0, [SILENT])
    events.see(104.0, [SILENT])
    assert events.content() == [
        {"text": ALARM.format(101.5), "from_s": 100.0, "to_s": 103.0, "times": 1},
        {"text": SILENT, "from_s": 103.0, "to_s": None, "times": 1},
    ]


def test_what_comes_back_at_once_is_counted_and_later_is_another() -> None:
    events = Events()
    for now_s, there in (
        (0.0, True),
        (1.0, False),
        (2.0, True),
        (3.0, False),
        (6.0, False),
        (7.0, True),
    ):
        events.see(now_s, [SILENT] if there else [])
    found = [(one["from_s"], one["to_s"], one["times"]) for one in events.content()]
    assert found == [(0.0, 3.0, 2), (7.0, None, 1)]
    ids = Events()
    ids.see(0.0, ["nothing on id 0x120 (A)", "nothing on id 0x121 (B)"])
    assert len(ids.content()) == 2, "another id is another event"


def test_a_night_of_them_keeps_the_last() -> None:
    events = Events()
    for k in range(3 * MOST):
        events.see(10.0 * k, [f"problem {chr(65 + k % 26)}{k}x"])
    assert len(events.content()) == MOST
    assert events.content()[-1]["to_s"] is None


def test_a_page_that_opens_later_is_told() -> None:
    hub = Hub(About("bus"), Store(), Marks(None))
    for t_ns, problems in ((10**18, [SILENT]), (10**18 + 4 * 10**9, [])):
        hub.take(b"J" + json.dumps({"t_ns": t_ns, "problems": problems}).encode())
    (event,) = json.loads(hub.state)["events"]
    assert event["text"] == SILENT
    assert event["to_s"] - event["from_s"] == 4.0
