"""What a check has found, and how it is told to a person."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from typing import List, Sequence


class Level(enum.Enum):
    """How good a finding is."""

    OK = "OK"
    WARNING = "WARNING"  # a run can begin, and may go worse than it could
    MISSING = "MISSING"  # no run can begin, or what it learns is worth nothing


class ExitCode(enum.IntEnum):
    """How the pre-flight check ends."""

    ALL_WELL = 0
    MISSING = 1
    WARNINGS = 2  # and nothing is missing


@dataclass(frozen=True)
class CheckResult:
    """One line of the list; what is not OK also has why it matters and how to mend it."""

    level: Level
    about: str
    found: str
    why: str = ""
    mend: str = ""

    def describe(self) -> str:
        """The line, and two more when something is to be done."""
        lines = [f"{self.level.value:8}{self.about:24}{self.found}"]
        if self.level is not Level.OK:
            lines += [f"{'':8}  why:  {self.why}", f"{'':8}  mend: {self.mend}"]
        return "\n".join(lines)

    def with_more(self, found: str) -> CheckResult:
        """The same finding with more of what was found."""
        return replace(self, found=f"{self.found}, {found}")


def fine(about: str, found: str) -> CheckResult:
    """A check that found what it wanted."""
    return CheckResult(Level.OK, about, found)


def warning(about: str, found: str, why: str, mend: str) -> CheckResult:
    """A check that found something a run can live with."""
    return CheckResult(Level.WARNING, about, found, why, mend)


def missing(about: str, found: str, why: str, mend: str) -> CheckResult:
    """A check that found something a run cannot live with."""
    return CheckResult(Level.MISSING, about, found, why, mend)


def names_at(findings: Sequence[CheckResult], level: Level) -> List[str]:
    """What the findings of a level are about, in their order and each once."""
    return list(dict.fromkeys(finding.about for finding in findings if finding.level is level))


def summary(findings: Sequence[CheckResult]) -> str:
    """One line about all of them."""
    lacking, doubtful = names_at(findings, Level.MISSING), names_at(findings, Level.WARNING)
    if not lacking and not doubtful:
        return f"all is well: {len(findings)} of {len(findings)} findings are OK"
    parts = []
    if lacking:
        parts.append(f"MISSING: {', '.join(lacking)}")
    if doubtful:
        parts.append(f"WARNING: {', '.join(doubtful)}")
    return f"not ready ({'; '.join(parts)})" if lacking else f"ready, with doubts ({'; '.join(parts)})"


def exit_code(findings: Sequence[CheckResult]) -> ExitCode:
    """0 only when all is well."""
    if names_at(findings, Level.MISSING):
        return ExitCode.MISSING
    return ExitCode.WARNINGS if names_at(findings, Level.WARNING) else ExitCode.ALL_WELL
