"""One table at the end of a night: what each folder of tests did, and what fell. `scripts/test --nightly` loads it.

It is also written to `outputs/nightly.txt`, for whoever comes in the morning.
"""

import time
from collections import Counter, defaultdict
from pathlib import Path

import pytest

from tests.support.paths import ROOT

FILE = ROOT / "outputs" / "nightly.txt"
_BEGAN = time.monotonic()
_OUTCOMES = ("passed", "failed", "error", "skipped", "rerun")


def table(stats: dict[str, list], seconds: float) -> str:
    """The table, and one line for each test that fell: its name, and the last line of its error.

    Args:
        stats: reports by outcome, as pytest's terminal reporter collects them.
        seconds: how long the run took.
    """
    counts: dict[str, Counter] = defaultdict(Counter)
    work: Counter[str] = Counter()
    for reports in stats.values():
        for report in (report for report in reports if isinstance(report, pytest.TestReport)):
            work[_folder(report)] += report.duration
    for outcome in _OUTCOMES:
        for report in stats.get(outcome, ()):
            counts[_folder(report)][outcome] += 1
    rows = [("tests", *_OUTCOMES, "work, min")]
    rows += [(name, *_numbers(counts[name]), f"{work[name] / 60:.1f}") for name in sorted(counts)]
    rows.append(("all", *_numbers(sum(counts.values(), Counter())), f"{work.total() / 60:.1f}"))
    lines = ["  ".join([row[0].ljust(24), *(cell.rjust(9) for cell in row[1:])]) for row in rows]
    fallen = [report for outcome in ("failed", "error") for report in stats.get(outcome, ())]
    lines += [f"{report.nodeid}: {_reason(report)}" for report in fallen]
    return "\n".join([*lines, f"{time.strftime('%Y-%m-%d %H:%M')}, {seconds / 60:.0f} minutes"])


def _folder(report: pytest.TestReport) -> str:
    return str(Path(*Path(report.nodeid.partition("::")[0]).parts[:2]))


def _numbers(counts: Counter) -> list[str]:
    return [str(counts[outcome]) for outcome in _OUTCOMES]


def _reason(report: pytest.TestReport) -> str:
    crash = getattr(report.longrepr, "reprcrash", None)
    text = crash.message if crash else str(report.longrepr)
    return next(iter(text.strip().splitlines()), "no message")[:200]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the table and keep it."""
    text = table(terminalreporter.stats, time.monotonic() - _BEGAN)
    terminalreporter.section("night")
    terminalreporter.write_line(text)
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(text + "\n")
