"""Report of the doctor, as text or JSON: facts in rows, and findings, each with one remedy."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any


class Severity(StrEnum):
    """Severity of a finding. Only problems change the exit status."""

    PROBLEM = "problem"  # a session would fail, or be unsafe
    WARNING = "warning"  # a session works, but not well or not for long
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """Problem, warning or note of the doctor.

    Attributes:
        where: interface, channel, motor, file or device.
        what: the fact, with numbers.
        remedy: one command, or one thing to do.
    """

    severity: Severity
    where: str
    what: str
    remedy: str


# Section -> title and columns of its table: keys of the rows, with "=heading" where the heading differs from the key.
_TABLES = {
    "interfaces": (
        "CAN interfaces",
        "name=interface, link, state, bitrate=bit/s, modes, restart_ms=restart-ms, queue_length=queue, waiting, "
        "refused, dropped, bus_offs=bus-offs, driver",
    ),
    "adapters": (
        "CAN adapters",
        "name=interface, driver, product, serial=serial number, port=USB port, number=channel, named_by=named by",
    ),
    "channels": ("Channels", "channel, arm, gripper, examined"),
    "motors": (
        "Motors",
        "channel, id, name=motor, type, state, firmware, firmware_sub=sub, hardware=hw, gear_ratio=gear, "
        "position_max_rad=PMAX, velocity_max_rad_s=VMAX, torque_max_nm=TMAX, timeout_s=time-out s, control_mode=mode, "
        "answers_on=answers, temp_mos_c=MOS °C, temp_rotor_c=coil °C, supply_v=V",
    ),
    "handles": (
        "Teaching handles",
        "channel, firmware, report_frequency_hz=reports by itself at Hz, trigger, trigger_rad=rad, buttons",
    ),
    "passive_leaders": (
        "Passive leaders",
        "channel, silent, quiet=report when asked, q_rad=joints rad, trigger, buttons",
    ),
    "rails": ("Rails", "channel, io, upper=upper switch, lower=lower switch, brake_on=brake engaged, homed"),
    "sessions": (
        "Live sessions (watched, not asked)",
        "channel, driver=driven by, mode, rate_hz=Hz, age_ms=age ms, name=motor, state, motor_age_ms=reply ms ago, "
        "lost, temp_mos_c=MOS °C, temp_rotor_c=coil °C",
    ),
    "latency": (
        "Reply latency",
        "channel, id, name=motor, samples, lost, p50_ms=p50 ms, p99_ms=p99 ms, max_ms=max ms, "
        "histogram=≤0.3 ≤0.5 ≤1 ≤2 ≤4 ≤8 ≤16 more",
    ),
    "gripper_calibration": (
        "Gripper calibration",
        "channel, gripper, state, span_rad=span rad, age_days=age days, file",
    ),
    "cameras": ("Cameras", "name=camera, nodes, serial=USB serial, port=USB port, speed_mbit=Mbit/s"),
    "host": ("This computer", "what, value"),
}


@dataclass
class Section:
    """Part of the report.

    Attributes:
        name: key in the JSON form, and in `_TABLES`.
        rows: facts as JSON values, None for unknown. The JSON form has all keys of a row, the table only its columns.
    """

    name: str
    rows: list[dict[str, Any]] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)

    def problem(self, where: str, what: str, remedy: str) -> None:
        self.findings.append(Finding(Severity.PROBLEM, where, what, remedy))

    def warn(self, where: str, what: str, remedy: str) -> None:
        self.findings.append(Finding(Severity.WARNING, where, what, remedy))

    def note(self, where: str, what: str, remedy: str) -> None:
        self.findings.append(Finding(Severity.NOTE, where, what, remedy))


Report = dict[str, Section]
"""Section name -> section, in order of output."""


def empty_report() -> Report:
    """Return a report with an empty section for each table."""
    return {name: Section(name) for name in _TABLES}


def _findings(report: Report) -> list[Finding]:
    """Return all findings, problems first."""
    order = list(Severity)
    return sorted((f for section in report.values() for f in section.findings), key=lambda f: order.index(f.severity))


def _counts(found: Sequence[Finding]) -> dict[str, int]:
    return {severity.value: sum(finding.severity is severity for finding in found) for severity in Severity}


def exit_status(report: Report) -> int:
    """Return the exit status: 0 if there is no problem, else 1."""
    return int(any(finding.severity is Severity.PROBLEM for finding in _findings(report)))


def as_json(report: Report) -> str:
    """Format the report as one JSON object: healthy, counts, findings, and the rows of each section."""
    found = _findings(report)
    document: dict[str, Any] = {
        "healthy": exit_status(report) == 0,
        "counts": _counts(found),
        "findings": [asdict(finding) for finding in found],
        **{name: section.rows for name, section in report.items()},
    }
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)


def as_text(report: Report, verbose: bool = False) -> str:
    """Format the verdict, the findings (each with its remedy on the next line), and with `verbose` the tables."""
    found = _findings(report)
    counts = _counts(found)
    words = ", ".join(f"{count} {name}{'' if count == 1 else 's'}" for name, count in counts.items())
    lines = [("not healthy: " if counts[Severity.PROBLEM] else "healthy: ") + words]
    for finding in found:
        lines.append(f"{finding.severity.value.upper():8} {finding.where}: {finding.what}")
        lines.append(f"{'':8} -> {finding.remedy}")
    tables = [(name, section) for name, section in report.items() if section.rows]
    if tables and not verbose:
        lines += ["", "--verbose shows what was measured"]
    for name, section in tables if verbose else ():
        lines += ["", _TABLES[name][0], *_table(section)]
    return "\n".join(lines)


def _table(section: Section) -> list[str]:
    columns = [column.partition("=") for column in _TABLES[section.name][1].split(", ")]
    rows = [[heading or key for key, _, heading in columns]]
    rows += [[_cell(row.get(key)) for key, _, _ in columns] for row in section.rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return [f"  {line}".rstrip() for line in lines]


def _cell(value: object) -> str:
    if value is None:
        return "?"
    if isinstance(value, list):
        return ",".join(map(str, value)) or "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)
