"""A proof as one page: figures beside their goals, pictures, failures with links, every case."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eps_hil import provenance
from eps_hil.proof import goals, score
from eps_hil.proof.judge import Judgement, failed
from eps_hil.proof.run import SEALS, Setting, judgement, long_seconds
from eps_hil.recordings.files import replacing
from eps_hil.report import page, proof_figures

PAGE, RESULT = "index.html", "proof.json"


def write(out: Path, setting: Setting, lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Page, pictures and JSON into ``out``; returns ``table`` and ``details`` as text, and the
    JSON's content as ``result``."""
    judged = [judgement(line) for line in lines]
    cases = [goals.Scored(j, line["worth"]) for j, line in zip(judged, lines, strict=True)]
    rows = goals.figures(cases, long_seconds(out))
    if setting.kinds:
        rows = [row for row in rows if row.cases]
    curve = score.reliability(judged, bins=10)
    pictures = {"reliability": proof_figures.reliability(curve, out / "reliability.png")}
    if proof_figures.alone(judged) or not setting.kinds:  # else there is nothing in them
        pictures |= {
            "confusion": proof_figures.confusion(judged, out / "confusion.png"),
            "concealment": proof_figures.concealment(lines, judged, out / "concealment.png"),
            "closed_loop": proof_figures.closed_loop(cases, out / "closed_loop.png"),
        }
    result = {
        "schema": "eps-hil/proof-concealed/1",
        "seed": setting.seed,
        "seeds": "proof" if setting.proof else "development",
        "quick": setting.quick,
        "cases": len(lines),
        "code": sorted({line["code"] for line in lines}),
        "seals": dict(line.split() for line in (out / SEALS).read_text().splitlines()),
        "figures": goals.as_json(rows),
        "shares": [
            {"what": s.what, "hits": s.hits, "cases": s.cases, "ci95": s.interval}
            for s in score.shares(judged)
        ],
        "reliability": [
            {"stated": stated, "right": right, "findings": n} for stated, right, n in curve
        ],
        "seconds": _seconds(lines),
        "failures": [line["id"] for line, j in zip(lines, judged, strict=True) if failed(j)],
        "provenance": provenance.content(),
    }
    with replacing(out / RESULT) as temporary:
        temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    page.write(out / PAGE, render(result, rows, lines, judged, pictures))
    return {"table": goals.table(rows), "details": score.report(judged), "result": result}


def render(
    result: Mapping[str, Any],
    rows: Sequence[goals.Figure],
    lines: Sequence[Mapping[str, Any]],
    judged: Sequence[Judgement],
    pictures: Mapping[str, Path],
) -> str:
    """The page's HTML, pictures inside."""
    told = [_told(line, j) for line, j in zip(lines, judged, strict=True)]
    return page.fill(
        "proof.html.jinja",
        result=result,
        rows=rows,
        shares=score.shares(judged),
        errors=score.parameter_errors(judged),
        told=told,
        failures=[one for one in told if one["failed"]],
        unanswered=sum(not j.answered for j in judged),
        pictures={name: page.picture(path) for name, path in pictures.items()},
        page_css=page.asset("page.css"),
    )


def _told(line: Mapping[str, Any], j: Judgement) -> dict[str, Any]:
    """One case for reading: what was hidden, how well, and what was said of it."""
    answer = line["answer"]
    concealed = answer["concealment"]
    findings = (line["diagnosis"] or {}).get("findings", [])
    worth = line["worth"]
    return {
        "id": j.id,
        "kind": j.kind,
        "hidden": [
            {"effect": e["effect"], "ratio": e["effect_to_noise"], "reached": e["reached"]}
            for e in answer["effects"]
        ],
        "decoy": j.decoy,
        "withheld": answer.get("withheld", []),
        "said": [(f["effect"], f["confidence"], f.get("confusable_with", [])) for f in findings],
        "verdict": j.verdict or line["problem"] or "no diagnosis",
        "failed": failed(j),
        "report": line["report"],
        "fit": concealed["wrong_model_fit_percent"],
        "above": 100 * concealed["seconds_above_noise"],
        "err": concealed["naive_err"],
        "stlsq": concealed["naive_stlsq"],
        "newtons": {
            name: worth[name]["rack_force_rmse_n"] if name in worth else None
            for name in ("baseline", "augmented", "oracle")
        },
        "on": "CAN" if answer.get("can") else "CSV",
        "programme": answer.get("programme", ""),
    }


def _seconds(lines: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Median time of hiding and of diagnosing a case (s, wall clock, beside what else ran)."""
    hidden = sorted(line["answer"]["seconds"] for line in lines)
    seen = sorted(line["seconds"] for line in lines if line["seconds"] and not line["problem"])
    return {
        "hiding": hidden[len(hidden) // 2] if hidden else None,
        "diagnosing": seen[len(seen) // 2] if seen else None,
    }
