"""The report as a plain table and as JSON."""

import json
from collections.abc import Sequence
from typing import Any

from lerobot_robot_yam.doctor.kit.findings import Finding, Section, Severity

_UNKNOWN = "?"


def findings(sections: Sequence[Section]) -> list[Finding]:
    """All findings, problems first."""
    order = list(Severity)
    return sorted((f for section in sections for f in section.findings), key=lambda f: order.index(f.severity))


def exit_status(sections: Sequence[Section]) -> int:
    """0 when there is no problem, else 1."""
    return int(any(finding.severity is Severity.PROBLEM for finding in findings(sections)))


def as_json(sections: Sequence[Section]) -> str:
    """One JSON object: healthy, counts, findings, and per section its rows."""
    found = findings(sections)
    report: dict[str, Any] = {
        "healthy": exit_status(sections) == 0,
        "counts": {severity.value: sum(f.severity is severity for f in found) for severity in Severity},
        "findings": [
            {"severity": f.severity.value, "where": f.where, "what": f.what, "remedy": f.remedy} for f in found
        ],
    }
    report |= {section.name: section.rows for section in sections}
    return json.dumps(report, indent=1, allow_nan=False, ensure_ascii=False)


def as_text(sections: Sequence[Section]) -> str:
    """Tables, then the findings, each with its remedy on a line of its own."""
    lines: list[str] = []
    for section in sections:
        if section.rows:
            lines += [section.title, *_table(section), ""]
    found = findings(sections)
    for finding in found:
        lines.append(f"{finding.severity.value.upper():8} {finding.where}: {finding.what}")
        lines.append(f"{'':8} -> {finding.remedy}")
    counts = {severity.value: sum(f.severity is severity for f in found) for severity in Severity}
    words = ", ".join(f"{count} {name}{'' if count == 1 else 's'}" for name, count in counts.items())
    lines += [""] * bool(found) + [("" if counts[Severity.PROBLEM] else "healthy: ") + words]
    return "\n".join(lines)


def _table(section: Section) -> list[str]:
    rows = [list(section.columns.values())]
    rows += [[_cell(row.get(key)) for key in section.columns] for row in section.rows]
    widths = [max(len(row[i]) for row in rows) for i in range(len(section.columns))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return [f"  {line}".rstrip() for line in lines]


def _cell(value: object) -> str:
    if value is None:
        return _UNKNOWN
    if isinstance(value, list):
        return ",".join(map(str, value)) or "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)
