"""What goes wrong when: a random list of faults, the same for the same seed."""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from soak.injected_faults import EVEN, RANDOM

BACK_S = 2.0  # of a leader's way home


@dataclass(frozen=True)
class Injection:
    """One thing that goes wrong.

    Attributes:
        number: its place in the schedule.
        at_s: seconds since the soak began; a little later when an arm is just being repaired.
        kind: a name in `RANDOM`.
        channel: whose arm; empty when it concerns no arm in particular.
        motor: of that arm; empty when it concerns no motor in particular.
        value: fault code, number of answers, offsets of a reading, share of answers, latency in s, times at which
            frames are held back, or force (3,) N.
        seconds: how long it lasts; 0 when it is over at once.
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
    """All injections of `duration_s` seconds, in order of time.

    Args:
        duration_s: length of the soak.
        seed: the same seed gives the same list, and a longer soak begins like a shorter one.
        pace: so many times as often as `RANDOM` says.
        kinds: only these.
    """
    found = []
    for kind in kinds:
        gap_s, draw = RANDOM[kind].gap_s, RANDOM[kind].draw
        rng = random.Random(f"{seed} {kind}")  # each kind has its own chance: leaving one out changes no other
        at_s = rng.uniform(0.0, gap_s / pace) if kind == EVEN else rng.expovariate(pace / gap_s)
        while at_s < duration_s:
            found.append((round(at_s, 3), kind, draw(rng)))
            at_s += gap_s / pace if kind == EVEN else rng.expovariate(pace / gap_s)
    found.sort(key=lambda row: row[0])
    return [Injection(number, at_s, kind, **details) for number, (at_s, kind, details) in enumerate(found)]


def hand_path(
    rng: random.Random, start: Sequence[float], seconds: float
) -> tuple[list[float], list[list[float]], list[float]]:
    """A way for the hand on a leader: every joint swings, now slowly, now faster than the follower may go.

    Args:
        start: (6,) rad, where the leader is.
        seconds: how long.

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
    """As `hand_path` for `lifted_s`, then home, where all joints are zero, in `BACK_S`, and there for `home_s`."""
    times, path, trigger = hand_path(rng, start, lifted_s)
    last, begin_s, squeeze = path[-1], times[-1], trigger[-1]
    for step in range(1, round(BACK_S / 0.1) + 1):
        share = 0.5 + 0.5 * math.cos(math.pi * step * 0.1 / BACK_S)
        times.append(begin_s + step * 0.1)
        path.append([share * angle for angle in last])
        trigger.append(squeeze)
    return [*times, times[-1] + home_s], [*path, path[-1]], [*trigger, squeeze]
