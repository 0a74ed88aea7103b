"""Check of a limp base that a person rolls: ids, directions and steering zeros, which no register tells.

A caster trails: once a limp base was pushed straight by some centimetres, its steering angle is 0. That shows every
zero that is off, and every steering motor that is swapped with its wheel's. In a turn the wheels of a base as
configured agree on one motion; if they do not, the exchange of motors is named with which they would.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from functools import partial

import can
import numpy as np

from lerobot_robot_yam.commands.lib.dialogue import table
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.motor_inspection import verify
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.base_profile import CASTERS
from lerobot_robot_yam.mobile.casters import Casters, wrapped
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase

SAMPLE_S = 0.02  # period of samples, s: at walking pace a wheel turns by less than half a turn
_STRAIGHT = "Push the base straight ahead by 0.5 m or more, at walking pace. Then press Enter."
_TURN = "Turn the base by a quarter turn or more, about any point. Then press Enter."
_LEAST_M = 0.2  # minimum way of a push, m: ten times what a caster needs to trail
_LEAST_TURNED_RAD = 5.0  # rotation that only a wheel makes within a push, rad: a caster turns by π at most
_ZERO_RAD = math.radians(5.0)  # tolerance of a steering zero, rad: a person does not push straighter
_BACK_RAD = math.radians(25.0)  # distance from half a turn within which a caster trails backwards, rad
_LEAST_HEADING_RAD = 1.0  # minimum turn, rad
_AGREE = 0.05  # maximum disagreement of the wheels, as a share of the squares of their motion; our choice
_BETTER = 5.0  # factor by which less disagreement counts as proof of an exchange

Person = Callable[[str, Callable[[], None]], None]
"""Function that shows an instruction, and calls the given function every `SAMPLE_S` until the person has done it."""


class RolledBase:
    """Limp base on an open bus that no other program uses.

    Attributes:
        rows: angles (8,) of all samples since `begin`, rad, in joint coordinates.

    Raises:
        MotorError: a motor does not reply, is energised, or is not a base's.
    """

    def __init__(self, config: BaseConfig, bus: can.BusABC):
        self.hardware = ResolvedBase(config)
        self._chain = MotorChain(bus, self.hardware.motors, channel=config.channel)
        self.clock = self._chain.clock
        verify(self._chain)
        self.begin()

    def begin(self) -> None:
        """Forget all samples but a new one."""
        self.rows: list[np.ndarray] = []
        self.sample()

    def sample(self) -> None:
        """Read all motors. Call every `SAMPLE_S`."""
        chain, asked = self._chain, self.clock.now()
        for _ in range(3):
            chain.refresh()
            if (chain.stamp_s >= asked).all():
                break
        silent = [spec.name for spec, s in zip(chain.motors, chain.stamp_s, strict=True) if s < asked]
        on = [spec.name for spec, f in zip(chain.motors, chain.fault, strict=True) if f == Fault.NORMAL]
        if silent or on:
            what = f"no answer from {', '.join(silent)}" if silent else f"{', '.join(on)} energised; end its program"
            raise MotorError(f"{self.hardware.name} ({chain.channel}): {what}")
        self.rows.append((chain.position_rad * self.hardware.sign)[:8])

    @property
    def steer(self) -> np.ndarray:
        """Steering angles (4,), rad, within -π … π."""
        return np.array([wrapped(angle) for angle in self.rows[-1][0::2]])

    @property
    def turned(self) -> np.ndarray:
        """Rotation of each motor since `begin`, (8,) rad."""
        return self.rows[-1] - self.rows[0]


def roll_check(base: RolledBase, person: Person) -> tuple[str, list[str]]:
    """Have a person push and turn the base; return a table, and a line per problem.

    Raises:
        MotorError: the base was not rolled far enough, or the other way round; or see `RolledBase`.
    """
    rows, problems = [], []
    for text, judge in ((_STRAIGHT, _straight), (_TURN, _turn)):
        base.begin()
        person(text, base.sample)
        radius = base.hardware.profile.radius_m
        turned, steer = base.turned, np.degrees(base.steer)
        if np.abs(turned).max() * radius < _LEAST_M:
            most = np.abs(turned).max() * radius
            raise MotorError(f"{base.hardware.name}: its wheels rolled by {most:.2f} m only; run it again, further")
        way = [f"{angle * radius:+.2f}" for angle in turned[1::2]]
        rows += [[name, f"{angle:+.0f}", m] for name, angle, m in zip(CASTERS, steer, way, strict=True)]
        problems = judge(base)
        if problems:
            break
    return table(["caster", "steering °", "wheel m"], rows), problems


def _straight(base: RolledBase) -> list[str]:
    profile, command = base.hardware.profile, base.hardware.config.on_command_line
    found = []
    for i, name in enumerate(CASTERS):
        (steer, drive), angle = np.abs(base.turned[2 * i : 2 * i + 2]), base.steer[i]
        ids = profile.steer_ids[i], profile.drive_ids[i]
        if steer > _LEAST_TURNED_RAD > drive:
            found.append(
                f"{name}: id {ids[0]} turns as a wheel does and id {ids[1]} as a caster: their ids are swapped "
                f"(yam-motors set-id {command})"
            )
        elif abs(angle) > _ZERO_RAD:
            found.append(
                f"{name}: it trails at {math.degrees(angle):+.0f}°, not at 0°: its zero is off "
                f"(yam-zero {command} --joint {name}_steer)"
            )
    if len(found) == len(CASTERS) and np.abs(base.steer).min() > math.pi - _BACK_RAD:
        raise MotorError(f"{base.hardware.name}: all casters trail backwards: was it pushed backwards? Run it again")
    return found


def _turn(base: RolledBase) -> list[str]:
    casters, rows = Casters(base.hardware.profile), np.array(base.rows)
    size = np.tile([abs(base.hardware.profile.b_x_m), base.hardware.profile.radius_m], len(CASTERS))  # rad to m
    found = sorted((_disagreement(casters, size, change(rows)), text) for text, change in _changes(base))
    (share, heading), text = found[0]
    if heading < _LEAST_HEADING_RAD:
        raise MotorError(f"{base.hardware.name}: it was turned by {heading:.1f} rad only; run it again, further")
    usual = next(share for (share, _), name in found if not name)
    if text and usual > _BETTER * share:
        return [text]
    return ["the wheels disagree on the turn: a wheel slips, or sizes are wrong"] if usual > _AGREE else []


def _disagreement(casters: Casters, size: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """Return by how much the wheels disagree, as a share of their motion, and the turn, rad."""
    left = heading = 0.0
    steps = np.diff(rows, axis=0)
    for row, step in zip(rows + 0.5 * np.vstack([steps, np.zeros(8)]), steps, strict=False):
        twist = casters.twist(row[0::2], step)
        left += float((((step - casters.rates(row[0::2], twist)) * size) ** 2).sum())
        heading += float(twist[2])
    return left / max(float(((steps * size) ** 2).sum()), 1e-12), abs(heading)


def _changes(base: RolledBase) -> Iterator[tuple[str, Callable[[np.ndarray], np.ndarray]]]:
    """Yield what may be wrong, and the function that undoes it in samples (k, 8); first nothing, with an empty text."""
    own, names = base.hardware.sign[:8], [motor.name for motor in base.hardware.motors]
    yield "", partial(_changed, order=list(range(8)), sign=np.ones(8))
    for i, j in itertools.combinations(range(len(CASTERS)), 2):
        for what, motors in (("casters", (0, 1)), ("wheels", (1,)), ("steering motors", (0,))):
            order = list(range(8))
            for k in motors:
                order[2 * i + k], order[2 * j + k] = 2 * j + k, 2 * i + k
            text = f"the ids of the {what} {CASTERS[i]} and {CASTERS[j]} are exchanged (yam-motors set-id)"
            yield text, partial(_changed, order=order, sign=own[order] * own)
    for motor, name in enumerate(names[:8]):
        sign = np.ones(8)
        sign[motor] = -1.0
        yield f"{name} turns the other way: look how it is mounted", partial(_changed, order=list(range(8)), sign=sign)


def _changed(rows: np.ndarray, order: list[int], sign: np.ndarray) -> np.ndarray:
    changed: np.ndarray = rows[:, order] * sign
    return changed
