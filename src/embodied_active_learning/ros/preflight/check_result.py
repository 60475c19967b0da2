"""Results of the preflight checks."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from typing import List, Sequence


class Level(enum.Enum):
    """Severity of a check result; the value of the most severe one is the exit status of the preflight script."""

    OK = 0
    WARNING = 2  # a run can start; its result may be worse
    ERROR = 1  # a run cannot start, or its result would be useless


@dataclass(frozen=True)
class CheckResult:
    """Result of one check.

    Attributes:
        name: what was checked.
        message: what was found.
        reason: why a warning or error matters.
        remedy: what to do about it.
    """

    level: Level
    name: str
    message: str
    reason: str = ""
    remedy: str = ""

    def describe(self) -> str:
        """Return one line, with two more for a warning or error."""
        lines = [f"{self.level.name:8}{self.name:24}{self.message}"]
        if self.level is not Level.OK:
            lines += [f"{'':10}reason: {self.reason}", f"{'':10}remedy: {self.remedy}"]
        return "\n".join(lines)

    def with_detail(self, detail: str) -> CheckResult:
        """Return a copy with a detail appended to the message."""
        return replace(self, message=f"{self.message}, {detail}")


def ok(name: str, message: str) -> CheckResult:
    """Return the result of a passed check."""
    return CheckResult(Level.OK, name, message)


def warning(name: str, message: str, reason: str, remedy: str) -> CheckResult:
    """Return a result that does not prevent a run."""
    return CheckResult(Level.WARNING, name, message, reason, remedy)


def error(name: str, message: str, reason: str, remedy: str) -> CheckResult:
    """Return a result that prevents a run or makes it useless."""
    return CheckResult(Level.ERROR, name, message, reason, remedy)


def names_at(results: Sequence[CheckResult], level: Level) -> List[str]:
    """Return the names of the results of a level, without duplicates."""
    return list(dict.fromkeys(result.name for result in results if result.level is level))


def summary(results: Sequence[CheckResult]) -> str:
    """Return one line on all results."""
    errors, warnings = names_at(results, Level.ERROR), names_at(results, Level.WARNING)
    parts = [f"{label}: {', '.join(names)}" for label, names in (("errors", errors), ("warnings", warnings)) if names]
    if errors:
        return f"not ready ({'; '.join(parts)})"
    return f"ready ({'; '.join(parts)})" if warnings else f"ready ({len(results)} of {len(results)} checks OK)"


def most_severe(results: Sequence[CheckResult]) -> Level:
    """Return the level of the most severe result."""
    found = {result.level for result in results}
    return next((level for level in (Level.ERROR, Level.WARNING) if level in found), Level.OK)
