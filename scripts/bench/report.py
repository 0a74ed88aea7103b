"""Readable results of the benchmark: a table of this driver beside the others, and a plot of the periods."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

Report = Mapping[str, Any]


_TICKS_MS = (1, 2, 3, 4, 5, 7, 10, 20, 30, 50, 70, 100, 200, 500)
_COLUMNS = ("ours", "damiao_bus", "vendor")
_TITLES = {"ours": "ours", "damiao_bus": "DamiaoMotorsBus", "vendor": "vendor SDK"}


def table(report: Report) -> str:
    """Return a table of the figures of all drivers, side by side."""
    rows: dict[str, dict[str, str]] = {}
    for column in _COLUMNS:
        for name, value in report.get(column, {}).items():
            rows.setdefault(name, {})[column] = _text(value)
    notes = [f"{_TITLES[c]}: {row[c]}" for name, row in rows.items() if name in ("missing", "failed") for c in row]
    lines = [f"wire limit {report['wire_limit_hz']:.1f} Hz", ""]
    width = max([len(name) for name in rows], default=0) + 2
    columns = [c for c in _COLUMNS if c in report and not report[c].keys() & {"missing"}]
    lines.append(" " * width + "".join(f"{_TITLES[c]:>36}" for c in columns))
    for name, row in rows.items():
        if name not in ("missing", "failed"):
            lines.append(f"{name:<{width}}" + "".join(f"{row.get(c, '–'):>36}" for c in columns))
    lines += ["", *notes, "", "periods and ages: p50 / p99 / p99.9 / max in ms"]
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return " / ".join(f"{v:.2f}" for v in value.values())
    return f"{value:.4g}" if isinstance(value, int | float) else str(value)


def json_text(report: Report) -> str:
    """Return the report as JSON; figures that could not be measured are null."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return json.dumps(plain(report), indent=1, allow_nan=False) + "\n"


def plot(periods_ms: Mapping[str, np.ndarray], path: Path) -> None:
    """Save a plot of the fraction of periods longer than x for each run, with logarithmic axes."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot, ticker

    figure, axes = pyplot.subplots(figsize=(8, 5), layout="constrained")
    for name, periods in periods_ms.items():
        if len(periods):
            longer = 1.0 - np.arange(len(periods)) / len(periods)
            axes.step(np.sort(periods), longer, where="post", label=f"{name} ({len(periods)} periods)")
    axes.axvline(4.0, color="0.7", linestyle=":", linewidth=1)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="period between ticks, stamped at the rig, ms",
        ylabel="share of periods at least that long",
        title="Control periods (dotted: 250 Hz)",
    )
    axes.xaxis.set_major_locator(ticker.FixedLocator(_TICKS_MS))
    axes.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axes.xaxis.set_minor_formatter(ticker.NullFormatter())
    axes.grid(which="both", alpha=0.25)
    if periods_ms:
        axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)
