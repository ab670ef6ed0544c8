"""A diagnosis as one self-contained HTML page that a rig engineer reads in two minutes (issue 5).

The page loads nothing: style, script (uPlot, from uplot-python) and data are inside,
and its content security policy forbids the rest. What comes from files is escaped by the template.
"""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eps_hil.diagnosis.attribute.scoring import FORWARD_SHARE, score, threshold
from eps_hil.diagnosis.balance.problem import term_of
from eps_hil.diagnosis.changes import in_short, in_words, what_would_show
from eps_hil.diagnosis.given_load import EMPIRICAL, Diagnosis
from eps_hil.diagnosis.remainder.ceiling import left_by_trees
from eps_hil.diagnosis.verdict.spoken import all_clear, but, shares_in_words
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.report import (
    diagnosis_evidence,
    diagnosis_figures,
    diagnosis_kinematics,
    diagnosis_map,
    diagnosis_maps,
    diagnosis_reversals,
    diagnosis_zero_torque,
    page,
)
from eps_hil.report.diagnosis_evidence import Evidence
from eps_hil.report.page import number
from eps_hil.report.plots import Plot

MOST_OTHERS = 6

MEASURES: Mapping[str, tuple[str, str, bool]] = {
    "torque_nrmse": ("NRMSE of the torque residual", "", False),
    "speed_fit_percent": ("fit of the simulated speed", "%", True),
    "rack_force_rmse_n": ("error of the rack-force estimate, moving", "N", False),
}
"""Names, units, and whether more is better, of CONTRACT 7's measures."""


CEILING = "the ceiling: with boosted trees on top"
_FREE_RUN: Mapping[str, tuple[str, str]] = {
    "speed_rmse_rad_s": ("whole hold-out simulated freely: error of the speed", "rad/s"),
    "angle_rmse_rad": ("the same: error of the angle", "rad"),
}


def write(diagnosis: Diagnosis, path: Path, model_name: str) -> None:
    """Write the page whole or not at all; ``model_name`` is the model file as the user calls it."""
    page.write(path, render(diagnosis, model_name))


def render(diagnosis: Diagnosis, model_name: str) -> str:
    """The page's HTML."""
    values, plots = values_of(diagnosis)
    return filled(values, plots, model_name)


def values_of(diagnosis: Diagnosis) -> tuple[dict[str, Any], list[Plot]]:
    """What the page shows, and its plots."""
    plots: list[Plot] = []
    return _values(diagnosis, plots), plots


def filled(values: Mapping[str, Any], plots: Sequence[Plot], model_name: str) -> str:
    """The page's HTML of what :func:`values_of` gave."""
    return page.fill(
        "diagnosis.html.jinja",
        filters={"plain": plain, "titled": titled, "named": named, "changed": in_words},
        model_name=model_name,
        **values,
        plots=[plot.content() for plot in plots],
        uplot_js=page.library("uPlot.iife.js"),
        uplot_css=page.library("uPlot.min.css"),
        page_js=page.asset("diagnosis.js"),
        page_css=page.asset("page.css"),
    )


_NAMES = {"Stribeck", "Coulomb", "Cardan"}


def plain(text: str) -> str:
    """A sentence with the signals and effects in it by name, not by their names in files."""
    text = re.sub(r"\babs_(?!motor_speed_rad_s\b)(?=[a-z])", "size of ", text)
    for signal, said in diagnosis_evidence.LABELS.items():
        text = re.sub(rf"\b{signal}\b", said.partition(" in ")[0], text)
    for effect in catalogue():
        text = text.replace(effect, effect.replace("_", " "))
    return text


def titled(effect: str) -> str:
    """An effect by its name in the field."""
    known = catalogue().get(effect)
    return effect.replace("_", " ") if known is None else known.name


def named(effect: str) -> str:
    """The same inside a sentence."""
    title = titled(effect)
    return title if title.partition(" ")[0] in _NAMES else title[0].lower() + title[1:]


def _split(diagnosis: Diagnosis) -> str:
    """What was fitted and what was kept from it, in words; one recording gives both in turn."""
    short = _short(diagnosis)
    fitted = [one.name for one in diagnosis.problem.recordings]
    kept = [one.prepared.name for one in diagnosis.judged]
    said = []
    for names, part in ((fitted, "first two thirds"), (kept, "last third")):
        halved = [short[name] for name in names if name in fitted and name in kept]
        whole = [short[name] for name in names if name not in fitted or name not in kept]
        said.append(
            ", ".join([*whole, *([f"the {part} of {' and of '.join(halved)}"] * bool(halved))])
        )
    return f"Fitted: {said[0]}. Kept from the fit: {said[1]}."


def _values(diagnosis: Diagnosis, plots: list[Plot]) -> dict[str, Any]:
    content, model = diagnosis.content, diagnosis.problem.model
    fitted, held_out = diagnosis_evidence.fitted(diagnosis), diagnosis_evidence.held_out(diagnosis)
    spots = diagnosis_figures.spots(fitted, content["time_segments"])
    profiles = diagnosis_maps.profiles(fitted)
    kept = diagnosis_figures.holdouts(diagnosis, held_out)
    cards = _cards(diagnosis, fitted, plots)
    plots += [*profiles, *(p for one in (*spots, *kept) for p in one["plots"])]
    ratio = model.rack_to_rotor_ratio_rad_per_m
    return {
        "content": content,
        "verdict": _verdict(content),
        "headlines": _headlines(cards),
        "located": _located(content),
        "cells": _cells(content),
        "cards": cards,
        "measures": _measures(content),
        "placebos": content["fit"].get("placebo", []),
        "ratio": ratio,
        "short": _short(diagnosis),
        "split": _split(diagnosis),
        "judged_names": [one.prepared.name for one in diagnosis.judged],
        "flags": _flags(content),
        "sliding_s": 8e-3 * int(fitted.sliding.sum()),
        "regions": diagnosis_maps.regions(fitted, content.get("location", {}).get("cells", [])),
        "strips": diagnosis_maps.strips(fitted),
        "scale": diagnosis_maps.scale(),
        "profiles": profiles,
        "spots": spots,
        "holdouts": kept,
        "ablation": _ablation(fitted, held_out, ratio),
        "ablation_terms": len(fitted.entries),
        "named": any(
            card["effect"] != "unknown" or _is_channel_fault(card) or card.get("model")
            for card in cards
        ),
        "others": _others(diagnosis),
        "shares": shares_in_words,
        "span": _span,
    }


def _verdict(content: Mapping[str, Any]) -> str:
    """The verdict as a sentence."""
    if "before" in content:
        return _what_changed(content)
    findings = [one["effect"] for one in content["findings"] if one["effect"] != "unknown"]
    named = list(dict.fromkeys(findings))  # two orders are one cogging
    limits = content.get("limits", [])
    sentences = {
        "no_mismatch": f"{all_clear(limits)}{'; see the limits below.' if limits else '.'}",
        "explained": f"The mismatch is explained by {_and(named)}{but(limits)}.",
        "partly_explained": f"The mismatch is explained in part, by {_and(named)}; "
        + (
            "something that no known effect explains is left."
            if len(findings) < len(content["findings"])
            else "recordings kept from the fit do not get better by it beyond chance."
        ),
        "unknown_effect": "Something is missing that no known effect explains; where it acts and "
        "its shape are below.",
    }
    if content["verdict"] == "unknown_effect" and any(
        one.get("model") for one in content["findings"]
    ):
        return (
            "Something is missing that the catalogue has no name for; it is modelled all the same, "
            "as written below."
        )
    if content["verdict"] == "unknown_effect" and all(map(_is_channel_fault, content["findings"])):
        return (
            "The mismatch is explained by one signal that is wrong, and by no effect of the drive."
        )
    return sentences[content["verdict"]]


def _what_changed(content: Mapping[str, Any]) -> str:
    """The verdict on two states of a rig."""
    known = [one["effect"] for one in content["before"]["findings"] if one["effect"] != "unknown"]
    both = f" Beyond the model file, the first state has {_and([*dict.fromkeys(known)])}."
    told = [
        f"{named(one['effect']) if one['effect'] != 'unknown' else 'something without a name'} "
        f"({in_short(one['change'])})"
        for one in content["findings"]
    ]
    if not told and content["undecided"]:
        return f"Not decided whether anything has changed; why is below.{both if known else ''}"
    if not told:
        return f"Nothing has changed that {what_would_show(content)}.{both if known else ''}"
    return f"What has changed: {'; '.join(told)}.{both if known else ''}"


def _is_channel_fault(finding: Mapping[str, Any]) -> bool:
    """Whether it is a signal that is late or too large, which was put right but has no name."""
    return finding["effect"] == "unknown" and finding["kind"] == "instrument"


def _and(names: Sequence[str]) -> str:
    plain = [named(name) for name in names]
    return "".join(plain) if len(plain) < 2 else f"{', '.join(plain[:-1])} and {plain[-1]}"


def _headlines(cards: Sequence[Mapping[str, Any]]) -> list[str]:
    """One sentence a finding, with its size at the rack."""
    told = []
    for card in cards:
        size = card["size"]
        if card["sizes"] and "rms_n" in card["sizes"]:
            size = f"{number(card['sizes']['rms_n'])} N rms"
        if card["sizes"]:
            size += f"{', ' if size else ''}up to {number(card['sizes']['peak_n'])} N"
        told.append(card["summary"].rstrip(".") + (f"; at the rack: {size}." if size else "."))
    return told


def _located(content: Mapping[str, Any]) -> str:
    """Where, in one sentence; empty where nothing stands out."""
    cells = content.get("location", {}).get("cells", [])
    if cells:
        cell = cells[0]
        return (
            f"{100 * cell['share_of_excess']:.0f} % of the mismatch sits in "
            f"{100 * cell['share_of_time']:.0f} % of the sliding time: {_sides(cell)}"
        )
    parts = []
    for finding in content["findings"]:
        regions = [one for one in finding["where"] if one["signal"] != "time_s"]
        regions = [one for one in regions if one["signal"] == regions[0]["signal"]]
        if regions:
            share = sum(one["share_of_excess"] for one in regions)
            much = f"{100 * share:.0f} % of it at " if share else ""
            places = " and ".join(_span(one) for one in regions)
            parts.append(f"{named(finding['effect'])}: {much}{places}")
    return "; ".join(parts)


def _cells(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What stands out of the operating region, one and two signals at a time."""
    cells = content.get("location", {}).get("cells", [])
    return [{**cell, "sides": _sides(cell)} for cell in cells]


def _sides(cell: Mapping[str, Any]) -> str:
    sides = zip(cell["signals"], cell["from"], cell["to"], strict=True)
    return " and ".join(_span({"signal": s, "from": low, "to": high}) for s, low, high in sides)


def _short(diagnosis: Diagnosis) -> dict[str, str]:
    """Names of recordings without the folder that they share."""
    names = [one.name for one in diagnosis.problem.recordings]
    names += [one.prepared.name for one in diagnosis.judged]
    folders = {os.path.dirname(name) for name in names}
    return {name: os.path.basename(name) if len(folders) == 1 else name for name in names}


def _flags(content: Mapping[str, Any]) -> list[str]:
    """What is wrong with the data: a line for each recording and kind of fault, with its signals.

    What a bus loses it loses of all its signals at once; parts of one recording are said once.
    """
    found: dict[tuple[str, str], dict[str, None]] = {}
    for look in content.get("data_quality", []):
        for channel in look["channels"]:
            if channel["flags"]:
                wrong = ", ".join(_fault(channel, flag) for flag in channel["flags"])
                name = diagnosis_evidence.label(channel["signal"]).partition(" in ")[0]
                found.setdefault((look["recording"], wrong), {})[name] = None
    return [f"{where}: {wrong}: {', '.join(names)}" for (where, wrong), names in found.items()]


def _fault(channel: Mapping[str, Any], flag: str) -> str:
    """A flag in words, with the moment where it is one of a moment."""
    words, spans = flag.replace("_", " "), channel.get(flag)
    return f"{words} from {spans[0][0]:.1f} s on" if isinstance(spans, list) else words


def _span(region: Mapping[str, Any]) -> str:
    """An interval of a signal with its unit at the end."""
    name, _, unit = diagnosis_evidence.label(region["signal"]).partition(" in ")
    unit, _, direction = unit.partition(", ")
    span = f"{name} {number(region['from'])} to {number(region['to'])} {unit}"
    return f"{span}, {direction}" if direction else span


def _cards(diagnosis: Diagnosis, fitted: Evidence, plots: list[Plot]) -> list[dict[str, Any]]:
    cards = []
    for one in diagnosis.content["findings"]:
        card: dict[str, Any] = {
            **one,
            "plot": None,
            "sizes": None,
            "size": "",
            "rivals": [],
            "laws": 0,
        }
        known = catalogue()[one["effect"]].parameters if one["effect"] in catalogue() else ()
        card["meanings"] = {parameter.name: parameter.meaning for parameter in known}
        if one["effect"] == "unknown":
            laws = _laws(fitted) if one.get("model") and "seen_in" not in one else []
            card["laws"] = len(laws)
            card["plot"] = (
                diagnosis_figures.finding(fitted, laws[0], ())[0]
                if laws
                else diagnosis_figures.unknown(one)
            )
            card["maps"] = diagnosis_map.maps(one)
            peak = max((abs(point[1]) for point in one["curve"]), default=0.0)
            ratio = diagnosis.problem.model.rack_to_rotor_ratio_rad_per_m
            if "seen_in" in one:
                card["size"] = f"up to {1e3 * peak / ratio:.3g} mm"
            else:
                card["sizes"] = {"peak_n": ratio * peak} if peak else None
            if laws:
                learnt = [k for k, e in enumerate(fitted.entries) if e["effect"] == EMPIRICAL]
                card["sizes"] = diagnosis_figures.sizes(fitted, learnt)
        elif (k := _place(fitted.entries, one)) is not None:
            card["plot"], card["sizes"] = diagnosis_figures.finding(fitted, k, one["where"])
            entries = diagnosis.selection.found.entries
            term = _place(entries, one)
            rivals = [] if term is None else diagnosis.selection.rivals.get(term_of(entries[term]))
            card["rivals"] = (rivals or [])[:4]
        elif one.get("seen_in") == "reversals":
            card["plot"] = diagnosis_reversals.figure(diagnosis)
        elif "seen_in" in one:
            told = one["seen_in"] == "zero torque"
            draw = diagnosis_zero_torque.figure if told else diagnosis_kinematics.figure
            card["plot"] = draw(diagnosis, one)
            card["size"] = diagnosis_kinematics.size(one, diagnosis.problem.model)
        if card["plot"] is not None:
            plots.append(card["plot"])
        cards.append(card)
    return cards


def _laws(fitted: Evidence) -> list[int]:
    """Entries that are laws and can be drawn beside the residual, what explains most first."""
    there = [k for k, one in enumerate(fitted.entries) if diagnosis_evidence.shows(one, fitted)]
    return sorted(there, key=lambda k: -fitted.rms_nm(fitted.without_nm[k] - fitted.after_nm))


def _place(entries: Sequence[Mapping[str, Any]], finding: Mapping[str, Any]) -> int | None:
    """Which entry a finding is: of several cogging orders the nearest."""
    same = [k for k, entry in enumerate(entries) if entry["effect"] == finding["effect"]]
    order = finding["parameters"].get("order", {}).get("value", 0.0)
    return min(same, key=lambda k: abs(entries[k].get("order", 0.0) - order), default=None)


def _titled(entry: Mapping[str, Any]) -> str:
    """An effect in words, with what tells it from others of its kind."""
    name = named(str(entry["effect"]))
    return f"{name} of order {entry['order']:.4g}" if "order" in entry else name


def _measures(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    holdout, rows = content["fit"]["holdout"], []
    for name, (title, unit, more) in MEASURES.items():
        if holdout["baseline"].get(name) is not None:
            rows.append(
                {
                    "name": name,
                    "title": title,
                    "unit": unit,
                    "more_is_better": more,
                    "before": holdout["baseline"][name],
                    "after": holdout["augmented"].get(name),
                    "floor": holdout["noise_floor"].get(name),
                }
            )
    runs = [holdout[one].get("free_run", {}) for one in ("baseline", "augmented")]
    for name, (title, unit) in _FREE_RUN.items():
        before, after = (run.get(name) for run in runs)
        if before is not None and after is not None:
            rows.append(
                {
                    "name": name,
                    "title": title,
                    "unit": unit,
                    "more_is_better": False,
                    "before": before,
                    "after": after,
                    "floor": None,
                }
            )
    seen = content.get("kinematics", {})
    there = diagnosis_kinematics.IN_ROTOR_AND_RACK
    shown = any("seen_in" in one and one["effect"] in there for one in content["findings"])
    if shown and "rms_left_rad" in seen:
        kept = "holdout_left_rad" in seen
        before, after = (
            ("holdout_rms_rad", "holdout_left_rad") if kept else ("rms_rad", "rms_left_rad")
        )
        rows.append(
            {
                "name": "kinematics",
                "title": "rotor angle against rack position, rms",
                "of": ", hold-outs" if kept else ", whole recordings",
                "unit": "mrad",
                "more_is_better": False,
                "before": 1e3 * seen[before],
                "after": 1e3 * seen[after],
                "floor": 1e3 * seen["noise_rad"],
            }
        )
    return rows


def _ablation(fitted: Evidence, held_out: Evidence, ratio: float) -> list[dict[str, Any]]:
    """Rms left over (N at the rack) on fitted and kept recordings without each term."""
    rows = [("baseline model", fitted.before_nm, held_out.before_nm)]
    named = [entry for entry in fitted.entries if entry["effect"] != "empirical"]
    if named and len(named) < len(fitted.entries):
        first, second = (
            one.problem.residual(one.problem.with_entries(named)) * one.problem.scale
            for one in (fitted, held_out)
        )
        rows.append(("with the named findings only", first, second))
    if fitted.entries:
        rows.append(("with all findings", fitted.after_nm, held_out.after_nm))
    for k, entry in enumerate(fitted.entries):
        name = f"all but {_titled(entry)}"
        rows.append((name, fitted.without_nm[k], held_out.without_nm[k]))
    told = [
        {
            "name": name,
            "fitted_n": ratio * fitted.rms_nm(first),
            "holdout_n": ratio * held_out.rms_nm(second),
        }
        for name, first, second in rows
    ]
    trees = left_by_trees(fitted.problem, held_out.problem, fitted.augmented)
    ceiling = ratio * held_out.rms_nm(trees * held_out.problem.scale)
    floors = (ratio * one.rms_nm(one.floor_nm) for one in (fitted, held_out))
    return [
        *told,
        {"name": CEILING, "fitted_n": None, "holdout_n": ceiling},
        dict(zip(("name", "fitted_n", "holdout_n"), ("sensor noise alone", *floors), strict=True)),
    ]


def _others(diagnosis: Diagnosis) -> dict[str, Any]:
    """What else was looked for: the best gains on unfitted blocks that were not accepted."""
    selection = diagnosis.selection
    problem, found = diagnosis.problem, selection.found
    if selection.part is not problem:  # hours of recordings: the candidates saw an excerpt
        problem, found = selection.part, selection.searched
    best: dict[str, float] = {}
    for one in score(problem, found, selection.pool):
        best.setdefault(one.candidate.effect.id, one.gain)
    named = {one["effect"] for one in diagnosis.content["findings"]}
    small = {name for name in best if (p := catalogue()[name].probe) is not None and p.least > 0}
    rows = [(name, gain, name in small) for name, gain in best.items() if name not in named]
    return {
        "rows": rows[:MOST_OTHERS],
        "looked_for": len(best) + len(named & set(catalogue())),
        "least": threshold(problem, found.residual, FORWARD_SHARE),
        "energy": found.cost,
    }
