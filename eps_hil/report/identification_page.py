"""An identification as one self-contained HTML page: numbers, map, coverage, delays, findings."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eps_hil.identification.friction_map import ENOUGH_S
from eps_hil.identification.result import Estimate, Identification
from eps_hil.report import identification_figure, page

MEANINGS = {
    "inertia_kg_m2": "inertia at the rotor, J",
    "friction.offset_pos_nm": "k0+",
    "friction.offset_neg_nm": "k0−",
    "friction.viscous_pos_nm_s_per_rad": "kω+",
    "friction.viscous_neg_nm_s_per_rad": "kω−",
    "friction.load_pos_nm_per_n": "kr+",
    "friction.load_neg_nm_per_n": "kr−",
    "friction.sigma0_nm_per_rad": "bristle stiffness σ0",
    "friction.sigma1_nm_s_per_rad": "bristle damping σ1",
    "friction.sigma1_speed_rad_s": "its speed width",
}


def write(found: Identification, path: Path, model_name: str) -> None:
    """Write the page whole or not at all; ``model_name`` is the model file as the user calls it."""
    page.write(path, render(found, model_name))


def render(found: Identification, model_name: str) -> str:
    """The page's HTML."""
    return page.fill(
        "identification.html.jinja",
        model_name=model_name,
        found=found,
        verdict=_verdict(found),
        parameters=_rows(found.parameters),
        offsets=_rows(found.offsets),
        skews=_rows(
            {**found.skews_s, **({"motor_lag": found.motor_lag} if found.motor_lag else {})}
        ),
        coverage=_coverage(found),
        enough_s=ENOUGH_S,
        figure=identification_figure.svg(found),
        css=page.asset("page.css"),
    )


def _verdict(found: Identification) -> str:
    known = sum(one.status == "identified" for one in found.parameters.values())
    kept = [name for name, one in found.parameters.items() if one.status == "kept"]
    words = f"{known} parameters identified from {found.seconds:.0f} s"
    if kept:
        words += f"; {len(kept)} keep the model file's value"
    return words


def _rows(estimates: Mapping[str, Estimate]) -> list[dict[str, Any]]:
    rows = []
    for name, one in estimates.items():
        scale, unit = (1e3, "ms") if one.unit == "s" else (1.0, one.unit)
        rows.append(
            {
                "name": name,
                "meaning": MEANINGS.get(name, ""),
                "value": f"{scale * one.value:.5g}",
                "interval": ""
                if one.ci95 is None
                else f"{scale * one.ci95[0]:.4g} to {scale * one.ci95[1]:.4g}",
                "unit": unit,
                "was": "" if one.from_model is None else f"{scale * one.from_model:.4g}",
                "status": one.status,
                "note": one.note,
            }
        )
    return rows


def _coverage(found: Identification) -> dict[str, Any]:
    """Rows from the fastest negative speed to the fastest positive one."""
    table = found.map
    bands = range(len(table.speeds) - 1)
    order = [(1, "−", i) for i in reversed(bands)] + [(0, "+", i) for i in bands]
    return {
        "loads": [
            f"{low:g} to {high:g}" for low, high in zip(table.loads, table.loads[1:], strict=False)
        ],
        "rows": [
            {
                "speed": f"{mark}{table.speeds[i]:g} to {mark}{table.speeds[i + 1]:g}",
                "cells": table.seconds[sign, i].tolist(),
            }
            for sign, mark, i in order
        ],
    }
