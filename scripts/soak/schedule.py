"""What goes wrong when: a random list of faults, the same for the same seed."""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lerobot_robot_yam.arm.profile_files import load_arm

FOLLOWERS = ("follower_left", "follower_right")
LEADERS = ("leader_left", "leader_right")
CHANNELS = FOLLOWERS + LEADERS
BACK_S = 2.0  # of a leader's way home
LOSS_RATE = 0.01  # of all frames to and from all motors, all the time
NIBBLES = (0x0, 0x8, 0x9, 0xA, 0xB, 0xC, 0xD, 0xE)  # every way in which a motor switches itself off
_JOINTS = load_arm("yam").joint_count
_BEYOND_RAD = 0.8  # what no motor can turn by within the four answers after which it is not believed any more
_PUSHED = ("link2", "link3", "link4", "gripper")


@dataclass(frozen=True)
class Injection:
    """One thing that goes wrong.

    Attributes:
        number: its place in the schedule.
        at_s: seconds since the soak began; a little later when an arm is just being repaired.
        kind: a name in `KINDS`.
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


def _motor(rng: random.Random, channel: str) -> str:
    names = [f"joint_{joint + 1}" for joint in range(_JOINTS)] + ["gripper"] * (channel in FOLLOWERS)
    return rng.choice(names)


def _on_motor(rng: random.Random, value: Any = None, seconds: float = 0.0) -> dict[str, Any]:
    channel = rng.choice(CHANNELS)
    return {"channel": channel, "motor": _motor(rng, channel), "value": value, "seconds": seconds}


def _on_channel(rng: random.Random, low_s: float, high_s: float) -> dict[str, Any]:
    return {"channel": rng.choice(CHANNELS), "seconds": rng.uniform(low_s, high_s)}


def _push(rng: random.Random) -> dict[str, Any]:
    force = [round(rng.uniform(-40.0, 40.0), 1) for _ in range(3)]
    return {
        "channel": rng.choice(FOLLOWERS),
        "motor": rng.choice(_PUSHED),
        "value": force,
        "seconds": rng.uniform(0.1, 0.5),
    }


def _offset(rng: random.Random, low: float, high: float) -> float:
    return round(rng.choice((-1.0, 1.0)) * rng.uniform(low, high), 3)


def _glitch(rng: random.Random) -> dict[str, Any]:
    """Fewer answers than make a fault, wrong by more than a joint can have moved between them."""
    value = {"position_rad": _offset(rng, _BEYOND_RAD, 13.0), "answers": rng.randint(1, 3)}
    if rng.random() < 0.5:
        value |= {"velocity_rad_s": _offset(rng, 0.0, 30.0), "torque_nm": _offset(rng, 0.0, 30.0)}
    return _on_motor(rng, value)


def _lie(rng: random.Random) -> dict[str, Any]:
    turn = rng.choice((0.0, 0.0, 2 * math.pi))  # a turn that was miscounted, or anything
    value = {"position_rad": math.copysign(turn, rng.uniform(-1, 1)) if turn else _offset(rng, _BEYOND_RAD, 9.0)}
    return _on_motor(rng, value, rng.uniform(0.1, 1.0))


def _held_back(rng: random.Random) -> dict[str, Any]:
    value = {"seconds": round(rng.uniform(0.02, 0.08), 3), "every_s": round(rng.uniform(0.2, 0.5), 3)}
    return _on_channel(rng, 0.5, 3.0) | {"value": value}


# Mean seconds between two of a kind, and what one of them is. Motor faults come at even intervals.
_EVEN = "motor_fault"
KINDS: dict[str, tuple[float, Callable[[random.Random], dict[str, Any]]]] = {
    _EVEN: (30.0, lambda rng: _on_motor(rng, rng.choice(NIBBLES))),
    # No silence (0.1 s), even of ticks that take three times as long as they should.
    "lost_replies": (2.0, lambda rng: _on_motor(rng, rng.randint(1, 8))),
    "motor_silent": (75.0, lambda rng: _on_motor(rng, seconds=rng.uniform(0.03, 1.5))),
    "reading_glitch": (4.0, _glitch),
    "reading_lies": (60.0, _lie),
    "garbled": (90.0, lambda rng: _on_channel(rng, 0.2, 1.0) | {"value": round(rng.uniform(0.1, 0.5), 2)}),
    "second_arm": (150.0, lambda rng: _on_channel(rng, 0.2, 1.5)),
    "slow_adapter": (60.0, lambda rng: _on_channel(rng, 0.5, 3.0) | {"value": round(rng.uniform(0.002, 0.02), 4)}),
    "held_back": (40.0, _held_back),
    "motor_hot": (240.0, lambda rng: {"channel": rng.choice(CHANNELS), "motor": "joint_2", "seconds": 2.0}),
    "cable_out_briefly": (50.0, lambda rng: _on_channel(rng, 0.01, 0.28)),
    "cable_out": (200.0, lambda rng: _on_channel(rng, 0.5, 2.0)),
    "link_down": (150.0, lambda rng: _on_channel(rng, 0.02, 0.28)),
    "bus_off": (300.0, lambda rng: _on_channel(rng, 0.02, 0.28)),
    "adapter_gone": (300.0, lambda rng: _on_channel(rng, 0.1, 1.0)),
    "handle_silent": (40.0, lambda rng: {"channel": rng.choice(LEADERS), "seconds": rng.uniform(0.1, 2.0)}),
    "caller_stall": (20.0, lambda rng: {"seconds": rng.uniform(0.1, 3.0)}),
    "kill_control": (120.0, lambda rng: {"channel": rng.choice(CHANNELS)}),
    "stop_control": (150.0, lambda rng: {"channel": rng.choice(CHANNELS)}),
    "emergency_stop": (60.0, lambda rng: {"seconds": rng.uniform(0.2, 3.0)}),
    "push": (12.0, _push),
    "far_action": (6.0, lambda rng: {"value": round(rng.uniform(-8.0, 8.0), 2)}),
}


def make_schedule(
    duration_s: float, seed: int, pace: float = 1.0, kinds: Sequence[str] = tuple(KINDS)
) -> list[Injection]:
    """All injections of `duration_s` seconds, in order of time.

    Args:
        duration_s: length of the soak.
        seed: the same seed gives the same list, and a longer soak begins like a shorter one.
        pace: so many times as often as `KINDS` says.
        kinds: only these.
    """
    found = []
    for kind in kinds:
        gap_s, details = KINDS[kind]
        rng = random.Random(f"{seed} {kind}")  # each kind has its own chance: leaving one out changes no other
        at_s = rng.uniform(0.0, gap_s / pace) if kind == _EVEN else rng.expovariate(pace / gap_s)
        while at_s < duration_s:
            found.append((round(at_s, 3), kind, details(rng)))
            at_s += gap_s / pace if kind == _EVEN else rng.expovariate(pace / gap_s)
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
