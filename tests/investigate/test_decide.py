"""When it goes on, and when it ends."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from eps_hil.investigate.decide import Stop, decide
from eps_hil.investigate.experiment import Experiment, Kind
from eps_hil.investigate.possible import Choice

ONE, TWO = Experiment(Kind.PASSES, 10.0), Experiment(Kind.PASSES, 20.0)


@dataclass
class Open:
    """Stands in for what is possible."""

    verdict: str | None = "explained"
    names: tuple[str, ...] = ("stribeck",)
    answered: bool = False
    rivals: list[Any] = field(default_factory=list)
    same: list[Any] = field(default_factory=list)
    left: tuple[Experiment, ...] = (ONE, TWO)

    @property
    def found(self) -> Any:
        if self.verdict is None:
            return None
        return SimpleNamespace(content={"verdict": self.verdict})

    @property
    def unnamed(self) -> bool:
        return "unknown" in self.names

    @property
    def in_part(self) -> bool:
        return self.unnamed or self.verdict == "partly_explained"

    def choices(self, done: list[Experiment], fresh: bool) -> list[Choice]:
        if not fresh and self.answered:
            return []
        left = [one for one in self.left if not (fresh and one in done)]
        return [Choice(one, 1.0, 0.25 * (k + 1), ()) for k, one in enumerate(left)]


def told(possible: Open) -> dict[str, Any]:
    """A round that found the same."""
    return {"verdict": possible.verdict, "findings": [{"effect": one} for one in possible.names]}


def decided(possible: Open, before: list[Any], done: Any = (), left_s: float = 600.0) -> Any:
    given: Any = possible
    return decide(given, before, list(done), left_s)


def test_it_goes_on_with_what_tells_most_while_something_is_open() -> None:
    possible = Open()
    decision = decided(possible, [told(possible)])
    assert decision.stop is None
    assert decision.choices[0].experiment == ONE


def test_names_have_to_stand_one_more_experiment() -> None:
    possible = Open(answered=True)
    first = decided(possible, [], [ONE])
    assert first.stop is None
    assert first.choices[0].experiment == TWO, "from elsewhere"
    assert decided(possible, [told(possible)], [ONE, TWO]).stop is Stop.SETTLED
    other = told(Open(names=("quadratic_drag",)))
    assert decided(possible, [other], [ONE]).stop is None


def test_names_that_no_experiment_tells_apart_are_not_settled() -> None:
    pair = SimpleNamespace(entry={"effect": "friction_asymmetry"}, rival="torque_sensor_offset")
    possible = Open(answered=True, same=[pair])
    decision = decided(possible, [told(possible)], [ONE])
    assert decision.stop is Stop.NOTHING_MORE
    assert "friction_asymmetry and torque_sensor_offset" in decision.why


def test_what_has_no_name_is_looked_at_from_elsewhere_and_then_left() -> None:
    possible = Open("unknown_effect", ("unknown",))
    before = [told(possible)]
    decision = decided(possible, before, [ONE])
    assert decision.choices[0].experiment == TWO
    assert "has no name" in decision.why
    assert decided(possible, before * 3, [ONE]).stop is Stop.NOTHING_MORE


def test_what_hold_outs_do_not_bear_out_is_not_settled() -> None:
    possible = Open("partly_explained", answered=False)
    before = [told(possible)]
    decision = decided(possible, before, [ONE])
    assert decision.choices[0].experiment == TWO
    assert "do not bear out" in decision.why
    ended = decided(possible, before * 3, [ONE, TWO])
    assert ended.stop is Stop.NOTHING_MORE
    assert "does not explain all" in ended.why


def test_the_budget_ends_it_and_a_shorter_experiment_may_still_fit() -> None:
    possible = Open()
    assert decided(possible, [], left_s=20.0).choices[0].experiment == ONE
    assert len(decided(possible, [], left_s=20.0).choices) == 1
    assert decided(possible, [], left_s=10.0).stop is Stop.BUDGET
