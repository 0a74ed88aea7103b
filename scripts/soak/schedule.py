"""Schedule of the soak: a random list of faults that is identical for identical seeds."""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from soak.injected_faults import EVEN, RANDOM

BACK_S = 2.0  # duration of a leader's return to home


@dataclass(frozen=True)
class Injection:
    """One scheduled fault.

    Attributes:
        number: index in the schedule.
        at_s: seconds since the start of the soak; the fault is delayed slightly while an arm is being recovered.
        kind: a name in `RANDOM`.
        channel: channel of the affected arm; empty if no particular arm is affected.
        motor: affected motor; empty if no particular motor is affected.
        value: fault code, number of replies, offsets of a reading, fraction of replies, latency in s, hold-back times,
            or force (3,) N.
        seconds: duration; 0 for an instantaneous fault.
    """

    number: int
    at_s: float
    kind: str
    channel: str = ""
    motor: str = ""
    value: Any = None
    seconds: float = 0.0

    def __str__(self) -> str:
        where = " ".join(part for part in (self.channel, self.motor) if part)
        value = "" if self.value is None else f" {self.value}"
        lasting = f" for {self.seconds:.2f} s" if self.seconds else ""
        return f"#{self.number} at {self.at_s:.1f} s: {self.kind} {where}{value}{lasting}"


def make_schedule(
    duration_s: float, seed: int, pace: float = 1.0, kinds: Sequence[str] = tuple(RANDOM)
) -> list[Injection]:
    """Return all injections within `duration_s` seconds, in order of time.

    Args:
        duration_s: duration of the soak.
        seed: the same seed gives the same list, and a longer soak begins like a shorter one.
        pace: factor on the frequencies in `RANDOM`.
        kinds: kinds to include.
    """
    found = []
    for kind in kinds:
        gap_s, draw = RANDOM[kind].gap_s, RANDOM[kind].draw
        rng = random.Random(f"{seed} {kind}")  # each kind has its own generator: omitting a kind changes no other
        at_s = rng.uniform(0.0, gap_s / pace) if kind == EVEN else rng.expovariate(pace / gap_s)
        while at_s < duration_s:
            found.append((round(at_s, 3), kind, draw(rng)))
            at_s += gap_s / pace if kind == EVEN else rng.expovariate(pace / gap_s)
    found.sort(key=lambda row: row[0])
    return [Injection(number, at_s, kind, **details) for number, (at_s, kind, details) in enumerate(found)]


def hand_path(
    rng: random.Random, start: Sequence[float], seconds: float
) -> tuple[list[float], list[list[float]], list[float]]:
    """Return a hand path for a leader: every joint swings, at times faster than the follower may move.

    Args:
        start: (6,) rad, present joints of the leader.
        seconds: duration.

    Returns:
        times (k,) s; joints (k, 6) rad; trigger (k,) 0 … 1.
    """
    centre = (0.0, 0.9, 0.9, 0.0, 0.0, 0.0)
    reach = (0.45, 0.35, 0.35, 0.45, 0.5, 0.8)
    waves = [[(rng.uniform(0.15, 0.5), rng.uniform(0, 2 * math.pi)) for _ in range(2)] for _ in range(7)]
    times, path, trigger = [], [], []
    for step in range(1, int(seconds * 10)):
        t = step * 0.1
        swing = [sum(math.sin(2 * math.pi * f * t + phase) for f, phase in wave) / 2 for wave in waves]
        blend = min(1.0, t / 2.5)
        goal = [c + r * s for c, r, s in zip(centre, reach, swing, strict=False)]
        path.append([a + blend * (b - a) for a, b in zip(start, goal, strict=True)])
        times.append(t)
        trigger.append(0.5 + 0.5 * swing[6])
    return times, path, trigger


def lift_and_return(
    rng: random.Random, start: Sequence[float], lifted_s: float, home_s: float
) -> tuple[list[float], list[list[float]], list[float]]:
    """Return `hand_path` for `lifted_s`, then a return to all joints at zero in `BACK_S`, held there for `home_s`."""
    times, path, trigger = hand_path(rng, start, lifted_s)
    last, begin_s, squeeze = path[-1], times[-1], trigger[-1]
    for step in range(1, round(BACK_S / 0.1) + 1):
        share = 0.5 + 0.5 * math.cos(math.pi * step * 0.1 / BACK_S)
        times.append(begin_s + step * 0.1)
        path.append([share * angle for angle in last])
        trigger.append(squeeze)
    return [*times, times[-1] + home_s], [*path, path[-1]], [*trigger, squeeze]
