"""An investigation told: lines for the terminal, one JSON, one page."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eps_hil.diagnosis.accept.proof_of_fit import more_than_noise
from eps_hil.diagnosis.verdict.spoken import all_clear
from eps_hil.investigate.journal import SCHEMA
from eps_hil.investigate.run import Outcome
from eps_hil.report import page

ENDS = {
    "settled": "Settled: nothing is open that an experiment on this rig would tell.",
    "budget": "The budget is spent.",
    "nothing_more": "Nothing more can be told on this rig within its limits.",
}
VERDICTS = {
    None: "no verdict yet",
    "no_mismatch": "nothing is missing",
    "explained": "explained",
    "partly_explained": "explained in part",
    "unknown_effect": "something is missing that has no name",
}


def named(findings: Sequence[Mapping[str, Any]]) -> str:
    """The names that were found, with their rivals."""
    told = []
    for one in findings:
        rivals = ", ".join(one["confusable_with"])
        told.append(one["effect"] + (f" (or {rivals})" if rivals else ""))
    return ", ".join(told)


def showed(content: Mapping[str, Any]) -> str:
    """What the recordings up to this round show."""
    if content["problem"]:
        return f"{VERDICTS[None]}: {content['problem']}"
    if content["verdict"] == "no_mismatch" and more_than_noise(content.get("limits", [])):
        return "no effect of the catalogue explains what differs"
    names = named(content["findings"])
    return VERDICTS[content["verdict"]] + (f": {names}" if names else "")


def possible(content: Mapping[str, Any]) -> str:
    """What was possible then."""
    names = [f"{effect} or {rival}" for effect, rival in content["open_names"]]
    count = len(content["open_effects"])
    unseen = f"{count} effects unseen" if count > 6 else ", ".join(content["open_effects"])
    return "; ".join([*names, *([unseen] if count else [])]) or "nothing that can be told"


def lines(content: Mapping[str, Any]) -> list[str]:
    """One round, for the terminal."""
    said = [f"{content['rig_s'] / 60.0:5.2f} min of rig: {showed(content)}"]
    if content["stop"] is None and not content["next"]:
        said.append("      every experiment that would tell more went beyond a limit before")
    elif content["stop"] is None:
        best = content["next"][0]
        said.append(f"      still possible: {possible(content)}")
        about = f" about {', '.join(best['about'])}" if best["about"] else ""
        said.append(
            f"      next: {best['words']} ({best['bits']:.3g} bits{about}): {content['why']}"
        )
    else:
        said.append(f"{ENDS[content['stop']]} ({content['why']})")
    return said


def content_of(outcome: Outcome) -> dict[str, Any]:
    """JSON-ready."""
    last = outcome.rounds[-1]
    return {
        "schema": SCHEMA,
        "stop": outcome.stop.value,
        "why": last["why"],
        "rig_s": outcome.rig_s,
        "verdict": last["verdict"],
        "findings": last["findings"],
        "rounds": list(outcome.rounds),
    }


def write_page(outcome: Outcome, path: Path, model_file: str) -> None:
    """The whole story as one HTML file."""
    rounds = list(outcome.rounds)
    rows = []
    for before, after in itertools.pairwise(rounds):
        best = before["next"][0]
        rows.append(
            {
                "number": after["round"],
                "possible": possible(before),
                "asked": best["words"],
                "why": before["why"],
                "about": ", ".join(best["about"]).replace("_", " "),
                "bits": best["bits"],
                "rate": best["bits_per_min"],
                "others": before["next"][1:],
                "showed": showed(after),
                "minutes": (after["rig_s"] - before["rig_s"]) / 60.0,
                "open_before": len(before["open_effects"]) + len(before["open_names"]),
                "open_after": len(after["open_effects"]) + len(after["open_names"]),
            }
        )
    last = rounds[-1]
    html = page.fill(
        "investigation.html.jinja",
        package="eps_hil.investigate",
        page_css=page.asset("page.css"),
        end=ENDS[outcome.stop.value],
        why=last["why"],
        minutes=outcome.rig_s / 60.0,
        verdict=showed(last),
        rows=rows,
        last=last,
        nothing_found=showed(last) if last["verdict"] is None else all_clear(last["limits"]),
        model_file=model_file,
    )
    page.write(path, html)
