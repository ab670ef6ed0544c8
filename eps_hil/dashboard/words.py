"""The monitor's figures as the page's state: what is missing or wrong in words, with the remedy."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from eps_hil.bus.port import BusState
from eps_hil.monitor.figures import Figures
from eps_hil.monitor.text import bits_in_words

_QUIET = ("age_s", "Crc", "Counter")
_SILENT_S = 1.0
_STARTING = {"rig": "is the rig there?", "service": "is the service (eps-hil run) there?"}
"""What is asked of a program that is missing: no question while it says that it starts."""
Source = tuple[str, int]
"""Message and id."""


def state_of(
    figures: Figures,
    sources: dict[str, Source],
    estimate: Source | None,
    lost: str = "",
    jobs: Iterable[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Everything the page shows beside its plots; ``lost``: why there is no bus.

    ``jobs``: what other programs on this bus say that they are doing (:mod:`eps_hil.board`).
    """
    plain = figures.as_json()
    starting = {str(job["kind"]): job for job in jobs if job.get("kind") in _STARTING}
    plain["told"] = {
        name: {
            "age_s": values["age_s"],
            "values": {k: _told(k, v) for k, v in values.items() if k not in _QUIET},
        }
        for name, values in plain["told"].items()
    }
    plain["jobs"] = [job for job in jobs if job.get("kind") not in _STARTING]
    plain["waiting"] = [f"the {job['title']} {job.get('text', '')}" for job in starting.values()]
    plain["problems"] = [
        problem for problem in problems(figures, sources, estimate, lost)
        if not any(answer in problem for kind, answer in _STARTING.items() if kind in starting)
    ]  # fmt: skip
    return plain


def problems(
    figures: Figures, sources: dict[str, Source], estimate: Source | None, lost: str = ""
) -> list[str]:
    """What is not as it should be, the worst first."""
    if lost or figures.bus.state == BusState.LOST:
        why = f": {lost}" if lost else ""
        return [f"bus lost{why}; it is opened again as soon as it is back"]
    never: dict[Source, list[str]] = {}
    silent: dict[Source, float] = {}
    for one in figures.signals:
        source = sources.get(one.name)
        if source is None:
            continue
        if math.isinf(one.age_s):
            never.setdefault(source, []).append(one.name)
        elif one.age_s > _SILENT_S:
            silent[source] = one.age_s
    if len(never) == len(set(sources.values())):
        return [f"waiting for frames of {_named(never)} on {figures.bus.name}; is the rig there?"]
    found = []
    if silent:
        found.append(f"nothing for {min(silent.values()):.0f} s and more: {_named(silent)}")
    if never:
        found.append(f"nothing yet: {_named(never)}")
    return found + _of_estimate(figures, estimate) + _alarms(figures)


def _named(sources: Iterable[Source]) -> str:
    return ", ".join(f"{name} (id 0x{can_id:X})" for name, can_id in sources)


def _of_estimate(figures: Figures, estimate: Source | None) -> list[str]:
    told = figures.estimate
    if told.status == "not in the DBC" or estimate is None:
        return ["no estimate: its message is not in the DBC"]
    name, can_id = estimate
    if told.status == "silent":
        where = f"nothing on id 0x{can_id:X} ({name})"
        if told.reasons == "no frame yet":
            return [f"{where} yet; is the service (eps-hil run) there?"]
        return [f"{where} any more: the service has stopped sending"]
    if told.status != "valid":
        return [f"estimate {told.status}: {told.reasons or 'no reason given'}"]
    return []


def _alarms(figures: Figures) -> list[str]:
    found, by_name = [], figures.residual.by_name()
    for name in figures.parted:
        rms = by_name[name]
        said = "–" if rms is None else f"{rms:.0f}"
        found.append(f"rig and model part, {name}: {said} N rms, "
                     f"limit {figures.limits.of(name):.0f} N")  # fmt: skip
    return found


def _told(key: str, value: Any) -> Any:
    if isinstance(value, int) and (words := bits_in_words(key, value)) is not None:
        return words
    return float(f"{value:.5g}") if isinstance(value, float) else value
