"""The bench's results for people: a table with ours beside the peers and the targets, and a plot of the periods."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Report = Mapping[str, Any]


@dataclass(frozen=True)
class Target:
    """A promise: `value(report)` (in `unit`) must be at least or at most `bound`.

    A ratio to a peer ends where physics ends: at `most(report)`, because of `why`. Where the peer is so good that this
    lies below the bound, a miss says so; it stays one.
    """

    what: str
    value: Callable[[Report], float]
    bound: float
    unit: str
    at_least: bool = False
    most: Callable[[Report], float] = lambda _: math.inf
    why: str = ""

    def judge(self, report: Report) -> tuple[float, bool | None]:
        """The value and whether the target is met; None where it was not measured."""
        try:
            value = float(self.value(report))
        except (KeyError, TypeError):
            return math.nan, None
        if math.isnan(value):
            return value, None
        return value, value >= self.bound if self.at_least else value <= self.bound

    def verdict(self, report: Report) -> str:
        """The value, the bound and whether it is met, for people."""
        value, met = self.judge(report)
        sign = "≥" if self.at_least else "≤"
        said = "not measured" if met is None else "met" if met else "MISSED"
        if met is False and self.most(report) < self.bound:
            said += f" ({self.why} allows {self.most(report):.3g})"
        return f"{self.what:<41}{value:>10.3g} {self.unit:<3} (target {sign} {self.bound:g}) {said}"


def _against_vendor(what: str, rate: str) -> Target:
    """Our loop with all it does beside the vendor's robot with all that does."""
    return Target(
        what,
        lambda r: r["ours"][rate] / r["vendor"][rate],
        1.8,
        "×",
        True,
        lambda r: r["wire_limit_hz"] / r["vendor"][rate],
        "the wire",
    )


_PERIOD_MS = 4.0  # of the ticks whose p99 is compared: 250 Hz

TARGETS = (
    Target(
        "share of the wire limit, one arm", lambda r: r["ours"]["unthrottled_hz"] / r["wire_limit_hz"], 0.85, "", True
    ),
    Target(
        "the same of two arms in one session",
        lambda r: r["ours"]["unthrottled_two_arms_hz"] / r["wire_limit_hz"],
        0.85,
        "",
        True,
    ),
    _against_vendor("tick rate against the vendor's, two arms", "unthrottled_two_arms_hz"),
    _against_vendor("the same, one arm", "unthrottled_hz"),
    _against_vendor("the same with 0.25 ms adapter latency", "unthrottled_latency_hz"),
    Target("period p99, caller hogged", lambda r: r["ours"]["hogged_ms"]["p99"], 5.0, "ms"),
    Target("period p99.9, caller hogged", lambda r: r["ours"]["hogged_ms"]["p999"], 7.0, "ms"),
    Target(
        "p99 against our thread mode, hogged",
        lambda r: r["ours"]["thread_hogged_ms"]["p99"] / r["ours"]["hogged_ms"]["p99"],
        10.0,
        "×",
        True,
        lambda r: r["ours"]["thread_hogged_ms"]["p99"] / _PERIOD_MS,
        "the period",
    ),
    Target("get + send, two arms, back to back", lambda r: r["ours"]["get_send_ms"], 0.3, "ms"),
    Target("get + send, two arms, at 60 Hz", lambda r: r["ours"]["get_send_paced_ms"], 0.3, "ms"),
    Target(
        "back to back against DamiaoMotorsBus",
        lambda r: r["damiao_bus"]["get_send_ms"] / r["ours"]["get_send_ms"],
        10.0,
        "×",
        True,
    ),
    Target("age of the sample, p99", lambda r: r["ours"]["age_ms"]["p99"], 6.0, "ms"),
    Target("older than that after a lost frame", lambda r: r["ours"]["age_after_lost_frame_ms"]["over"], 4.0, "ms"),
    Target("import on top of lerobot", lambda r: r["ours"]["import_ms"], 50.0, "ms"),
    Target("connect, rig and grippers ready", lambda r: r["ours"]["connect_s"], 2.0, "s"),
)

_TICKS_MS = (1, 2, 3, 4, 5, 7, 10, 20, 30, 50, 70, 100, 200, 500)
_COLUMNS = ("ours", "damiao_bus", "vendor")
_TITLES = {"ours": "ours", "damiao_bus": "DamiaoMotorsBus", "vendor": "vendor SDK"}


def table(report: Report) -> str:
    """Figures of all drivers side by side, then the targets."""
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
    lines += ["", *notes, "", "periods and ages: p50 / p99 / p99.9 / max in ms", ""]
    lines += [target.verdict(report) for target in TARGETS]
    lines += ["", _windows_text(report)]
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        numbers = [v for key, v in value.items() if key != "count"]
        return " / ".join(f"{v:.2f}" for v in numbers)
    return f"{value:.4g}" if isinstance(value, int | float) else str(value)


def _windows_text(report: Report) -> str:
    used = sum(row["used_s"] for row in report["windows"].values())
    total = sum(row["total_s"] for row in report["windows"].values())
    return (
        f"undisturbed (less than 1 % steal): {used:.0f} s of {total:.0f} s; "
        f"load before the run {report['machine']['load'][0]:.1f} on {report['machine']['cores']} cores"
    )


def json_text(report: Report) -> str:
    """The report as JSON; a figure that could not be measured is null."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return json.dumps(plain(report), indent=1, allow_nan=False) + "\n"


def plot(periods_ms: Mapping[str, np.ndarray], path: Path) -> None:
    """Save the share of periods longer than x, for each run; both axes logarithmic."""
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
