"""Friction levels of the running service: learnt or given, taken without a bump, replayed exactly.

The rig's friction is 40 % beside what the service believes. Frames are those of the bus; the core
is the service's own, so what holds here holds live, in a replay and in lock-step.
"""

import asyncio
import json
import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from eps_hil.adaptation.reversal import ReversalSettings
from eps_hil.bus.frame import Frame
from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.estimation.levels import FrictionLevels
from eps_hil.estimation.stream import Estimate
from eps_hil.physics.model import Model, load_model
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.manoeuvre import Driver, Manoeuvre, Motor, Rig, Segment
from eps_hil.rig.process import RigSimulation
from eps_hil.rig.profile import Sine, _Profile
from eps_hil.service.adaptation_config import AdaptationConfig
from eps_hil.service.config import ServiceConfig, load_config
from eps_hil.service.friction_levels import LevelEvent
from eps_hil.service.level_updates import LevelUpdates, levels_of
from eps_hil.service.online_methods import with_levels
from eps_hil.service.setup import Parts, describe, prepare
from eps_hil.service.whole_lines import WholeLines

from .conftest import DATABASE

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "configs" / "demo_udp.yaml"
MODEL = load_model(ROOT / "configs" / "reference_rig.yaml")
OWN = levels_of(MODEL)
MS, T0_NS = 1_000_000, 1_790_000_000_000_000_000
SLEW_N = 2513.0 * 0.005e-3
"""What the force may move in a millisecond because levels are gone over to."""
SHORT = ReversalSettings(stretch_s=3.0)
BOTH = AdaptationConfig(method="reversals", apply="both_known", reversals=SHORT)


def scaled(factor: float) -> FrictionLevels:
    return FrictionLevels(OWN.positive_nm * factor, OWN.negative_nm * factor)


def weave(seconds: float, amplitude: float = 1.5, tyre: float = 46e3) -> Manoeuvre:
    """A driver turns the wheel to and fro, half a turn a second."""
    angle = _Profile(sine=Sine(amplitude=amplitude, frequency_hz=0.5, fade_s=0.5))
    segment = Segment(
        duration_s=seconds,
        rig=Rig(stiffness_n_per_m=tyre, damping_n_s_per_m=500.0 if tyre else 0.0),
        driver=Driver(angle_rad=angle, stiffness_nm_per_rad=30.0, damping_nm_s_per_rad=1.0),
        motor=Motor(assist_nm_per_nm=0.2, damping_nm_s_per_rad=5e-4),
    )
    return Manoeuvre("weave", (segment,))


def frames_of(model: Model, manoeuvre: Manoeuvre, t0_ns: int = T0_NS) -> list[list[Frame]]:
    """What is on the bus, millisecond by millisecond."""
    setup = load_rig_setup(CONFIG)
    simulation = RigSimulation(replace(setup, model=model, manoeuvre=manoeuvre))
    return [
        [
            replace(frame, t_ns=t0_ns + k * MS + place * 60_000)
            for place, frame in enumerate(simulation.step(k * MS))
        ]
        for k in range(simulation.rows)
    ]


@pytest.fixture(scope="module")
def driven() -> list[list[Frame]]:
    """Nine seconds of driving with a rig whose friction is 40 % higher than the model's."""
    return frames_of(with_levels(MODEL, scaled(1.4)), weave(9.0))


def service(adaptation: AdaptationConfig | None, config: ServiceConfig | None = None) -> Parts:
    made = prepare(replace(config or load_config(CONFIG), adaptation=adaptation), CONFIG)
    made.warm_up()
    made.core.record = []
    return made


def run(parts: Parts, frames: Sequence[Sequence[Frame]]) -> list[Estimate]:
    for batch in frames:
        parts.core.on_frames(batch)
    assert parts.core.record is not None
    return [estimate for _, estimate in parts.core.record]


def forces(estimates: Sequence[Estimate]) -> np.ndarray:
    return np.array([one.rack_force_n for one in estimates])


def in_bunches(frames: Sequence[Sequence[Frame]], size: int) -> Iterator[list[Frame]]:
    flat = [frame for batch in frames for frame in batch]
    for since in range(0, len(flat), size):
        yield flat[since : since + size]


@pytest.fixture(scope="module")
def plain(driven: list[list[Frame]]) -> list[Estimate]:
    return run(service(None), driven)


@pytest.fixture(scope="module")
def adapted(driven: list[list[Frame]]) -> tuple[Parts, list[Estimate], list[LevelEvent]]:
    parts = service(BOTH)
    estimates = run(parts, driven)
    return parts, estimates, parts.levels.take_events()


@pytest.mark.slow
def test_levels_are_learnt_and_taken_while_driving(
    adapted: tuple[Parts, list[Estimate], list[LevelEvent]],
) -> None:
    parts, _, events = adapted
    first = events[0]
    assert (first.fate, first.source) == ("taken", "reversals")
    assert first.t_ns - T0_NS < 4_000 * MS, "after the first stretch"
    assert first.levels == pytest.approx(scaled(1.4), rel=0.03)
    assert {event.fate for event in events[1:]} <= {"agrees", "taken"}
    gone_s = (T0_NS + 9_000 * MS - first.t_ns) * 1e-9
    moved = parts.estimator.friction_levels.negative_nm - OWN.negative_nm
    assert moved == pytest.approx(min(0.005 * gone_s, 0.4 * OWN.negative_nm), rel=0.03)
    assert parts.estimator.friction_levels.positive_nm == pytest.approx(1.4 * 0.056, rel=0.03)


@pytest.mark.slow
def test_no_step_in_the_published_force_is_larger_than_an_ordinary_one(
    adapted: tuple[Parts, list[Estimate], list[LevelEvent]], plain: list[Estimate]
) -> None:
    before, after = forces(plain), forces(adapted[1])
    taken = (adapted[2][0].t_ns - T0_NS) // MS
    assert np.array_equal(before[: taken - 60], after[: taken - 60])
    ordinary = np.abs(np.diff(before[1000:])).max()
    assert np.abs(np.diff(after[1000:])).max() < 1.02 * ordinary
    # Between two turns, where the rotor slides, the force moves by the slew (and by what eq. 3 then
    # makes of the other force, 12 % up or down on this rig).
    turns = 0.5 + np.arange(9.0)
    since = turns[np.searchsorted(turns, taken * 1e-3)]  # the first turn with new levels
    between = slice(round(1e3 * since) + 300, round(1e3 * since) + 850)
    added = np.diff(after - before)[between]
    assert np.abs(np.median(added)) == pytest.approx(SLEW_N, rel=0.15)
    assert np.abs(after - before)[-2000:].max() > 50.0, "and it does move"


@pytest.mark.slow
def test_a_replay_in_bunches_learns_and_publishes_the_same_bit_for_bit(
    adapted: tuple[Parts, list[Estimate], list[LevelEvent]], driven: list[list[Frame]]
) -> None:
    again = service(BOTH)
    assert run(again, list(in_bunches(driven, 11))) == adapted[1]
    assert again.levels.take_events() == adapted[2]


@pytest.mark.slow
def test_the_operators_levels_come_back_in_a_replay(driven: list[list[Frame]]) -> None:
    live = service(BOTH)
    run(live, driven[:2000])
    live.core.on_frames(driven[2000][:1])  # in the middle of a millisecond
    live.levels.operator(scaled(1.25))
    run(live, [driven[2000][1:], *driven[2001:7000]])
    events = live.levels.take_events()
    assert (events[0].fate, events[0].source, events[0].levels) == (
        "taken",
        "operator",
        scaled(1.25),
    )
    assert [event.source for event in events].count("reversals") >= 1, "it goes on learning"
    replay = service(BOTH)
    replay.levels.operator(events[0].levels, events[0].t_ns)  # as the journal says
    assert run(replay, driven[:7000]) == [one for _, one in live.core.record or []]
    assert replay.levels.take_events() == events


@pytest.mark.slow
def test_a_log_and_its_journal_give_what_was_published(
    driven: list[list[Frame]], tmp_path: Path
) -> None:
    live = service(AdaptationConfig())
    run(live, driven[:2000])
    live.levels.operator(scaled(1.3))
    estimates = run(live, driven[2000:4000])
    log, journal, out = (tmp_path / name for name in ("bus.log", "journal.jsonl", "out.parquet"))
    log.write_text(
        "".join(
            f"({frame.t_ns // 10**9}.{frame.t_ns // 1000 % 10**6:06d}) can0 "
            f"{frame.can_id:03X}#{frame.data.hex().upper()}\n"
            for batch in driven[:4000]
            for frame in batch
        )
    )
    (event,) = live.levels.take_events()
    journal.write_text(json.dumps(event.as_json()) + "\n")
    words = ["estimate", str(log), "--model", str(ROOT / "configs" / "reference_rig.yaml")]
    words += ["--dbc", str(ROOT / "dbc" / "eps_rig.dbc"), "--out", str(out)]
    words += ["--signals", str(ROOT / "configs" / "eps_rig_signals.yaml")]

    def table(*more: str) -> np.ndarray:
        assert main([*words, *more]) == 0
        return np.array(pq.read_table(out)["rack_force_estimate_n"])

    told = forces(estimates)[-3900:]
    assert np.array_equal(table("--friction-journal", str(journal))[-3900:], told)
    assert not np.array_equal(table()[-3900:], told), "without the journal it is not the same"


@pytest.mark.parametrize("line", ["no json", "[]", '{"levels": "taken"}'])
def test_what_is_no_journal_is_named_with_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    journal = tmp_path / "j.jsonl"
    journal.write_text('{"levels": "refused"}\n' + line + "\n")
    model = str(ROOT / "configs" / "reference_rig.yaml")
    words = ["estimate", "no.csv", "--model", model, "--friction-journal", str(journal)]
    assert main(words) == 2
    assert "j.jsonl: line 2: is no event of a journal" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("adaptation", "why"),
    [
        (replace(BOTH, apply="never"), "adaptation.apply is never"),
        (
            replace(BOTH, reversals=replace(SHORT, load_cell=False)),
            "only the sum of both is known",
        ),
        (replace(BOTH, sanity_band=0.2), "more than 20% from the accepted"),
    ],
)
def test_what_shall_not_be_taken_changes_nothing(
    adaptation: AdaptationConfig, why: str, driven: list[list[Frame]], plain: list[Estimate]
) -> None:
    parts = service(adaptation)
    assert run(parts, driven[:7000]) == plain[:7000]
    events = parts.levels.take_events()
    assert len(events) >= 2
    assert all(why in event.why for event in events), events
    fate = "refused" if "more than" in why else "suggested"
    assert {event.fate for event in events} == {fate}
    assert sum(events[-1].levels) == pytest.approx(1.4 * sum(OWN), rel=0.03)
    values = parts.levels.suggestion_values()
    assert values["SuggestionFate"] == (2 if fate == "refused" else 0)
    assert values["SumDeviation"] > 0.0


@pytest.mark.slow
def test_friction_that_changed_over_an_hour_is_followed(driven: list[list[Frame]]) -> None:
    """The stamps jump by an hour, as after a pause; the friction is another one then."""
    parts = service(BOTH)
    run(parts, driven[:4500])
    later = frames_of(with_levels(MODEL, scaled(1.1)), weave(5.0), T0_NS + 3_600_000 * MS)
    run(parts, later)
    events = [event for event in parts.levels.take_events() if event.fate == "taken"]
    assert events[0].levels == pytest.approx(scaled(1.4), rel=0.03)
    assert events[-1].levels == pytest.approx(scaled(1.1), rel=0.03)


@pytest.mark.slow
def test_error_injection_learns_on_line_near_the_centre() -> None:
    frames = frames_of(with_levels(MODEL, scaled(0.7)), weave(8.0, amplitude=0.15, tyre=0.0))
    adaptation = AdaptationConfig(method="error_injection", apply="both_known", error_sliding_s=1.5)
    parts = service(adaptation)
    run(parts, frames)
    events = parts.levels.take_events()
    assert events[0].fate == "learning"
    taken = [event for event in events if event.fate == "taken"]
    assert taken[-1].levels == pytest.approx(scaled(0.7), rel=0.03)
    again = service(adaptation)
    assert run(again, list(in_bunches(frames, 5))) == [one for _, one in parts.core.record or []]
    assert again.levels.take_events() == events
    assert math.isnan(parts.levels.suggestion_values()["SumDeviation"])


@pytest.mark.parametrize(
    ("levels", "why"),
    [
        (scaled(1.6), "more than 50% from the accepted"),
        (scaled(0.4), "more than 50% from the accepted"),
        (FrictionLevels(math.nan, 0.1), "no friction levels"),
        (FrictionLevels(-0.01, 0.1), "no friction levels"),
        (FrictionLevels(0.06, math.inf), "no friction levels"),
    ],
)
def test_the_operators_slip_is_refused(levels: FrictionLevels, why: str) -> None:
    keeper = service(None).levels
    keeper.operator(levels)
    (event,) = keeper.take_events()
    assert event.fate == "refused"
    assert why in event.why
    assert keeper.level_values()["LevelPositive"] == OWN.positive_nm
    assert keeper.level_values()["LevelChanges"] == 0


def test_the_band_lies_about_what_was_accepted_last() -> None:
    keeper = service(None).levels
    keeper.operator(scaled(1.4))
    keeper.operator(scaled(2.0))
    assert [event.fate for event in keeper.take_events()] == ["taken", "taken"]
    assert keeper.level_values()["LevelSource"] == 1


def test_more_changes_than_can_wait_are_refused_and_nothing_breaks() -> None:
    keeper = service(None).levels
    for _ in range(40):
        keeper.operator(scaled(1.1))
    fates = [event.fate for event in keeper.take_events()]
    assert fates == ["taken"] * 32 + ["refused"] * 8


def test_what_is_published_about_levels() -> None:
    parts = service(replace(BOTH, apply="sum_known"))
    frames = LevelUpdates(parts, lambda _: None).frames()
    told = {f.can_id: DATABASE.decode_message(f.can_id, f.data) for f in frames}
    assert told[0x150]["LevelPositive"] == pytest.approx(0.056)
    assert str(told[0x150]["LevelSource"]) == "model"
    assert str(told[0x151]["SuggestionKnown"]) == "nothing"
    assert str(told[0x151]["SumDeviation"]) == "SNA"
    assert {0x150, 0x151} <= set(parts.send_ids)
    said = "\n".join(describe(parts))
    assert "reversals: applied where their sum is known, within 50%" in said
    assert "0x151 EPSHIL_FrictionSuggestion every 0.1 s" in said
    assert set(service(None).send_ids) == {0x120, 0x121, 0x400}


def test_a_message_that_the_database_lacks_is_named() -> None:
    with pytest.raises(InputError, match=r"adaptation\.message: .*has no message EPSHIL_Levels"):
        service(AdaptationConfig(message="EPSHIL_Levels"))


def test_each_entry_is_written_once_where_the_end_comes_during_a_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread goes on writing after its task was cancelled."""
    path, parts = tmp_path / "levels.jsonl", service(BOTH)
    begun, go_on = threading.Event(), threading.Event()
    append = WholeLines.append

    def slow(self: WholeLines, text: str) -> None:
        begun.set()
        go_on.wait(5.0)
        append(self, text)

    monkeypatch.setattr(WholeLines, "append", slow)
    updates = LevelUpdates(parts, lambda _: None, path)
    for factor in (1.1, 1.2, 1.3):
        parts.levels.operator(scaled(factor))

    async def ended() -> None:
        task = asyncio.create_task(updates.keep())
        assert await asyncio.to_thread(begun.wait, 5.0)
        task.cancel()
        asyncio.get_running_loop().call_later(0.05, go_on.set)
        await asyncio.wait_for(asyncio.gather(task, return_exceptions=True), 5.0)

    asyncio.run(ended())
    found = [json.loads(line)["offset_pos_nm"] for line in path.read_text().splitlines()]
    assert found == pytest.approx([factor * OWN.positive_nm for factor in (1.1, 1.2, 1.3)])


def test_an_event_as_a_line_of_json() -> None:
    keeper = service(None).levels
    keeper.operator(scaled(1.1))
    keeper.operator(scaled(9.0))
    taken, refused = (json.loads(json.dumps(e.as_json())) for e in keeper.take_events())
    assert taken["levels"] == "taken"
    assert taken["before"]["offset_pos_nm"] == OWN.positive_nm
    assert taken["offset_neg_nm"] == pytest.approx(1.1 * OWN.negative_nm)
    assert refused["before"] == {k: taken[k] for k in ("offset_pos_nm", "offset_neg_nm")}
    assert "why" in refused
