"""The mobile base in plain Python, without LeRobot.

    from lerobot_robot_yam.session.yam_base import YamBase

    with YamBase(channel="can_base") as base:           # on leaving, the base brakes and torque is cut
        base.set_target_velocity([0.2, 0.0, 0.0])       # repeat at 10 Hz or faster, or the base brakes
        print(base.odometry())

With `interface="yam_sim", channel="base", can_options={"scene": "mobile"}` the same lines drive the virtual rig.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.base_target import Frame
from lerobot_robot_yam.mobile.rail_profile import RailState
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.base_client import BaseClient
from lerobot_robot_yam.session.uncopyable import Uncopied
from lerobot_robot_yam.state.base_records import BaseState
from lerobot_robot_yam.system.clock import Clock


class Odometry(NamedTuple):
    """Pose (3,), m, m, rad, and velocities (3,), m/s, m/s, rad/s, in the odometry's and in the body's frame."""

    pose: np.ndarray
    twist: np.ndarray
    body_twist: np.ndarray


class WheelStates(NamedTuple):
    """Angles and rates of the casters (4,): rear left, front left, front right, rear right; rad, rad/s."""

    steer_rad: np.ndarray
    steer_rad_s: np.ndarray
    drive_rad: np.ndarray
    drive_rad_s: np.ndarray


class YamBase(Uncopied):
    """Mobile base on one CAN channel. SI units; +x forward, +y left, rotation counter-clockwise.

    Args:
        config: configuration of the base; or give its fields as keywords.
        isolation: where the control loop runs, see `ArmSession`.

    Raises:
        ConfigError: a field is unknown, or a value is impossible.
    """

    def __init__(self, config: BaseConfig | None = None, *, isolation: Isolation = "process", **fields: Any):
        unknown = set(fields) - {field.name for field in dataclasses.fields(BaseConfig)}
        if unknown:
            raise ConfigError(f"BaseConfig has no field {sorted(unknown)}")
        self.config = BaseConfig(**fields) if config is None else dataclasses.replace(config, **fields)
        self._session = ArmSession([self.config], isolation)

    def connect(self) -> "YamBase":
        """Energise the base, which stays where it is. Return this object.

        Raises:
            YamError: a part is missing or differs; nothing is energised.
        """
        self._session.start()
        return self

    def close(self) -> None:
        """Brake, cut torque, end the session. Idempotent."""
        self._session.stop()

    def __enter__(self) -> "YamBase":
        return self if self._session.running else self.connect()

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def clock(self) -> Clock:
        """Clock of the base's loop: the computer's, or that of a rig in lock-step."""
        return self._session.clock

    @property
    def _client(self) -> BaseClient:
        return self._session.base(self.config.name)

    def observe(self) -> BaseState:
        """Read the newest state. Raises YamError: see `BaseClient.observe`."""
        return self._client.observe()

    def set_target_velocity(self, velocity: Sequence[float] | np.ndarray, frame: str = "local") -> np.ndarray:
        """Write a target twist (3,), m/s, m/s, rad/s; see `BaseClient.write_velocity`. frame: "local" or "global"."""
        return self._client.write_velocity(velocity, _frame(frame))

    def set_target_pose(self, pose: Sequence[float] | np.ndarray, frame: str = "global") -> np.ndarray:
        """Write a target pose (3,), m, m, rad; see `BaseClient.write_pose`. frame: "global" or "local"."""
        return self._client.write_pose(pose, _frame(frame))

    def odometry(self) -> Odometry:
        """Return pose and velocities since the last reset, from the wheels alone."""
        state = self.observe()
        return Odometry(state.pose, state.twist, state.body_twist)

    def reset_odometry(self) -> None:
        """Make the present pose the origin. Raises LifeCycleError: the base drives to a pose of the odometry."""
        self._client.reset_odometry()

    def wheel_states(self) -> WheelStates:
        """Return angles and rates of the casters."""
        state = self.observe()
        return WheelStates(state.steer_rad, state.steer_rad_s, state.drive_rad, state.drive_rad_s)

    def set_rail_velocity(self, velocity: float) -> float:
        """Write a target velocity of the rail, m/s, positive up; see `BaseClient.write_rail_velocity`."""
        return self._client.write_rail_velocity(velocity)

    def set_rail_height(self, height: float) -> float:
        """Write a target height of the rail, m; see `BaseClient.write_rail_height`."""
        return self._client.write_rail_height(height)

    def home_rail(self) -> None:
        """Drive the rail up and down to its switches, and wait for the end; see `BaseClient.home_rail`."""
        self._client.home_rail()

    def rail_state(self) -> RailState:
        """Return height, velocity, switches and brake of the rail."""
        return self._client.rail_state()

    def hold(self) -> None:
        """Brake and stay."""
        self._client.hold()

    def rearm(self) -> None:
        """Enable failed motors again. Raises LifeCycleError: a motor still fails."""
        self._client.rearm()


def _frame(name: str) -> Frame:
    try:
        return Frame[name.upper()]
    except (KeyError, AttributeError):
        raise ActionError(f"frame is local or global, not {name!r}") from None
