"""What a doctor says: a grade, of what, what was seen, and what to do about it."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


class Grade(IntEnum):
    """How bad it is, the worse the higher."""

    OK = 0
    WARN = 1
    FAIL = 2


class Finding(NamedTuple):
    """One line of a report. `remedy`: empty where all is well."""

    grade: Grade
    what: str
    seen: str
    remedy: str = ""

    def __str__(self) -> str:
        """The line as people read it."""
        return f"{self.grade.name:4}  {self.what:12} {self.seen}{'; ' + self.remedy if self.remedy else ''}"


def ok(what: str, seen: str) -> Finding:
    """All is well."""
    return Finding(Grade.OK, what, seen)


def warn(what: str, seen: str, remedy: str) -> Finding:
    """It runs, and should be looked at."""
    return Finding(Grade.WARN, what, seen, remedy)


def fail(what: str, seen: str, remedy: str) -> Finding:
    """It does not work."""
    return Finding(Grade.FAIL, what, seen, remedy)


def worst(findings: list[Finding]) -> Grade:
    """The worst grade of a report."""
    return max((finding.grade for finding in findings), default=Grade.OK)
