"""What the doctor hands over: facts in rows, and findings, each with the one thing that repairs it."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Severity(StrEnum):
    """How much a finding matters. Only problems change the exit status."""

    PROBLEM = "problem"  # a session would fail, or be unsafe
    WARNING = "warning"  # it works, but not well or not for long
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """One thing found.

    Attributes:
        where: interface, channel, motor, file or device.
        what: what is so, with the numbers.
        remedy: one command, or one thing to do.
    """

    severity: Severity
    where: str
    what: str
    remedy: str


@dataclass
class Section:
    """One part of the report.

    Attributes:
        name: key in the JSON form.
        title: headline of the table.
        columns: key of a row -> heading, for the table; rows may hold more, which the JSON form shows.
        rows: facts, JSON values; None is "unknown".
    """

    name: str
    title: str
    columns: dict[str, str]
    rows: list[dict[str, Any]] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)

    def problem(self, where: str, what: str, remedy: str) -> None:
        """Add a problem."""
        self.findings.append(Finding(Severity.PROBLEM, where, what, remedy))

    def warn(self, where: str, what: str, remedy: str) -> None:
        """Add a warning."""
        self.findings.append(Finding(Severity.WARNING, where, what, remedy))

    def note(self, where: str, what: str, remedy: str) -> None:
        """Add a note."""
        self.findings.append(Finding(Severity.NOTE, where, what, remedy))
