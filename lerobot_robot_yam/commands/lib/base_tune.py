"""Measured drive of a base: the radius of its wheels from a straight way, its track from a turn."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import yaml

from lerobot_robot_yam.errors import ConfigError, LifeCycleError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.session.arm_session import Isolation
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.paths import write_whole

_SPEED = 0.2, 0.5  # of the straight way, m/s, and of the turn, rad/s: so slow that nothing slips
_PERIOD_S = 0.05
_SETTLE_S = 1.0  # time at rest before odometry is read, s
_MOST_OFF = 0.2  # maximum difference between measured and counted way, as a share: more is a mistake
_STOPPED = "the emergency stop was latched; nothing is kept. Release it (`yam-estop release`), and begin again"

Ask = Callable[[str, float], float]
"""Function that asks for a number; it gets the question and the likely answer."""


class BaseSizes(NamedTuple):
    """Measured sizes, for the options of the same names."""

    wheel_radius_m: float
    track_factor: float


def measure_base(config: BaseConfig, distance_m: float, ask: Ask, isolation: Isolation = "process") -> BaseSizes:
    """Drive straight and turn once; ask after each how far that was.

    Raises:
        ConfigError: a measured way differs too much from the counted one.
        YamError: the base has failed; it has stopped.
    """
    with YamBase(config, isolation=isolation) as base:
        counted = _drive(base, [_SPEED[0], 0.0, 0.0], 0, distance_m)
        way = _share(ask(f"It has counted {counted:.3f} m. How far has it gone, m?", counted), counted, "way")
        turned = _drive(base, [0.0, 0.0, _SPEED[1]], 2, math.tau)
        degrees = math.degrees(turned)
        asked = ask(f"It has counted {degrees:.1f}°. By how much has it turned, degrees?", degrees)
        turn = _share(asked, degrees, "turn")
    # The heading is way of the wheels / track: a larger radius needs a larger track for the same heading.
    return BaseSizes(round(config.wheel_radius_m * way, 6), round(config.track_factor * way / turn, 5))


def _drive(base: YamBase, velocity: list[float], axis: int, goal: float) -> float:
    """Drive with a velocity until the odometry has counted `goal` on an axis; return what it has counted at rest."""
    base.reset_odometry()
    acceleration = base.config.acceleration_limit[axis]
    while base.odometry().pose[axis] < goal - 0.5 * velocity[axis] ** 2 / acceleration:
        if base.observe().mode is Mode.STOPPED:  # else it would drive on as soon as somebody releases the stop
            raise LifeCycleError(f"{base.config.name}: {_STOPPED}")
        base.set_target_velocity(velocity)
        base.clock.sleep(_PERIOD_S)
    base.hold()
    base.clock.sleep(velocity[axis] / acceleration + _SETTLE_S)
    return float(base.odometry().pose[axis])


def _share(measured: float, counted: float, what: str) -> float:
    share = measured / counted
    if not 1.0 - _MOST_OFF <= share <= 1.0 + _MOST_OFF:
        raise ConfigError(f"the measured {what} is {share:.2f} times the counted one: too far off; nothing is kept")
    return share


def write_sizes(path: Path, sizes: BaseSizes) -> None:
    """Write the sizes into a rig's file or run config. Comments are kept at its head only.

    Raises:
        ConfigError: the file has no robot with a base.
    """
    text = path.read_text()
    document = yaml.safe_load(text)
    robot = document.get("robot") or {}
    base = robot.get("base_config", robot) if isinstance(robot, dict) else None
    if not isinstance(base, dict) or "channel" not in base:
        raise ConfigError(f"{path} has no robot with a base")
    base |= sizes._asdict()
    lines = text.splitlines(keepends=True)
    count = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), 0)
    head = "".join(lines[:count])
    write_whole(path, head + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, allow_unicode=True))
