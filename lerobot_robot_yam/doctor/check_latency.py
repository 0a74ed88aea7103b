"""Latency of the motors' answers, one question at a time."""

from collections.abc import Sequence
from itertools import pairwise

from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.round_trip import SLOW_S
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.doctor.kit.questions import Questions
from lerobot_robot_yam.doctor.kit.targets import Target

BIN_EDGES_MS = (0.3, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # upper edges of the bins; one more bin is for the rest
BLOCKS = "·▁▂▃▄▅▆▇█"
_LABELS = (*(f"≤{edge:g}" for edge in BIN_EDGES_MS), "more")
_TIMEOUT_S = 0.25
_GIVE_UP = 3  # lost replies in a row after which a motor is skipped
_LOST_MAX = 0.01  # largest tolerable share of lost replies
_TICK_MS = 4.0  # tick of a loop at 250 Hz, ms
_QUICKER = (
    "use another adapter; of a serial one, lower the latency timer: "
    "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB*/latency_timer"
)


def measure_latency(
    questions: Questions, target: Target, motors: Sequence[MotorSpec], samples: int, section: Section
) -> None:
    """Request feedback of each motor `samples` times, in turn; add rows and findings."""
    answers: dict[int, list[float | None]] = {spec.can_id: [] for spec in motors}  # ms, None: lost
    for _ in range(samples):
        for can_id, told in answers.items():
            if told[-_GIVE_UP:] != [None] * _GIVE_UP:
                seconds = questions.round_trip_s(can_id, _TIMEOUT_S)
                told.append(None if seconds is None else seconds * 1e3)
    times_ms = {can_id: sorted(ms for ms in told if ms is not None) for can_id, told in answers.items()}
    quickest = min((ms for times in times_ms.values() if (ms := percentile(times, 0.5))), default=0.0)
    if quickest > 2e3 * SLOW_S:
        what = f"answers take {quickest:.1f} ms: the adapter is slow, and the arm is seen and commanded that much "
        section.problem(target.channel, f"{what}too late", _QUICKER)
    for spec in motors:
        _report(target, spec, times_ms[spec.can_id], len(answers[spec.can_id]), section)


def _report(target: Target, spec: MotorSpec, times_ms: Sequence[float], asked: int, section: Section) -> None:
    counts, p99, lost = histogram(times_ms), percentile(times_ms, 0.99), asked - len(times_ms)
    section.rows.append(
        {
            "channel": target.channel,
            "id": spec.can_id,
            "name": spec.name,
            "samples": asked,
            "lost": lost,
            "p50_ms": percentile(times_ms, 0.5),
            "p99_ms": p99,
            "max_ms": round(times_ms[-1], 3) if times_ms else None,
            "histogram": bars(counts),
            "bin_edges_ms": list(BIN_EDGES_MS),
            "counts": counts,
        }
    )
    where = f"{target.channel} motor {spec.name} (id {spec.can_id})"
    if lost:
        add = section.problem if lost > _LOST_MAX * asked else section.warn
        remedy = "reseat the CAN cables of the arm and check the terminators (120 Ω at both ends)"
        add(where, f"{lost} of {asked} replies were lost", remedy)
    if p99 is not None and p99 > _TICK_MS:
        what = f"one reply in a hundred takes longer than {p99:.1f} ms; a tick of the loop is {_TICK_MS:g} ms"
        section.warn(where, what, "plug the adapter into a separate USB port, and stop what keeps the CPUs busy")


def histogram(times_ms: Sequence[float]) -> list[int]:
    """Count the times per bin of `BIN_EDGES_MS`, and those above."""
    edges = (float("-inf"), *BIN_EDGES_MS, float("inf"))
    return [sum(low < value <= high for value in times_ms) for low, high in pairwise(edges)]


def percentile(ordered: Sequence[float], share: float) -> float | None:
    """Value below which `share` of an ordered list lies, ms; None for an empty list."""
    return round(ordered[min(int(share * len(ordered)), len(ordered) - 1)], 3) if ordered else None


def bars(counts: Sequence[int]) -> str:
    """Draw a block per bin, as high as its count, as wide as its label; a bin with any count shows at least a line."""
    most, steps = max(max(counts), 1), len(BLOCKS) - 1
    blocks = (BLOCKS[-(-count * steps // most)] for count in counts)
    return " ".join(block.ljust(len(label)) for block, label in zip(blocks, _LABELS, strict=True)).rstrip()
