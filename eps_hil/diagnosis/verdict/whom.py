"""Findings said of what the rig was compared with: an effect's sentence speaks of "the model".

Where the baseline is somebody's simulator, or another state of the rig, that would be the wrong
one: the model file may say something else than both.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any

_IS = re.compile(r"\bwhat the model(?: file)? says")
_THAN = re.compile(r"\bthan the model(?: file)? says")
_IT = re.compile(r"\bthe model\b(?! file)")
_UNKNOWN = "unknown"


def against(
    findings: Iterable[Mapping[str, Any]], whom: str, of: str = "", verb: str = "is"
) -> list[dict[str, Any]]:
    """The findings with ``whom`` (``the simulator``, ``the first state``) in the model's place.

    ``of``: said before each, where it is not plain which state has it.
    """
    return [
        {
            **one,
            "summary": of
            + (one["summary"] if one["effect"] == _UNKNOWN else _said(one["summary"], whom, verb)),
        }
        for one in findings
    ]


def _said(summary: str, whom: str, verb: str) -> str:
    summary = _IS.sub(f"what it {verb} in {whom}", summary)
    return _IT.sub(whom, _THAN.sub(f"than in {whom}", summary))
