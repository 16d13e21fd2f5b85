"""One line of a check-up: what was looked at, what was found, what is needed, and what to do."""

from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    """It would work, with less comfort or certainty."""
    FAIL = "fail"
    """It would not work."""
    MISSING = "missing"
    """There is no device; nothing that needs it was looked at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The result of one check."""

    what: str
    found: str
    needed: str
    verdict: Verdict = Verdict.OK
    advice: str = ""
    """What to do; empty if nothing is to be done."""

    def as_dict(self) -> dict[str, str]:
        """Return it as plain values."""
        return {
            "what": self.what,
            "found": self.found,
            "needed": self.needed,
            "verdict": self.verdict.value,
            "advice": self.advice,
        }


def exit_code(findings: list[Finding]) -> int:
    """Return 0 if it would work, 3 if there is no device, else 1."""
    verdicts = {finding.verdict for finding in findings}
    if Verdict.MISSING in verdicts:
        return 3
    return 1 if Verdict.FAIL in verdicts else 0
