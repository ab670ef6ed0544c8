"""What a person should know beside the numbers: a finding, and what cannot be told apart."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about the recordings that a person should know; ``kind`` is for programs."""

    kind: str
    recording: str
    signal: str
    summary: str

    def content(self) -> dict[str, str]:
        """JSON-ready."""
        return {
            "kind": self.kind,
            "recording": self.recording,
            "signal": self.signal,
            "summary": self.summary,
        }


@dataclass(frozen=True, slots=True)
class Unknown:
    """Two causes that look alike (``what``), why, and what to do (empty: nothing would)."""

    what: str
    why: str
    remedy: str

    def content(self) -> dict[str, str]:
        """JSON-ready."""
        return {"what": self.what, "why": self.why, "remedy": self.remedy}
