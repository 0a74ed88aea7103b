"""The base of a LeRobot robot: keys, units, and conversions between LeRobot's numbers and the base's.

    x.vel, y.vel, theta.vel          velocity in the body's frame, m/s, m/s, deg/s: actions and, measured, observations
    x.pos, y.pos, theta.pos          odometry, m, m, deg (option observe_odometry)
    rear_left_steer.pos …            angles of the casters, rad (option observe_wheels)
    rear_left_drive.vel …            rates of the wheels, rad/s (option observe_wheels)

All names end in .pos or .vel, since lerobot-rollout drops other numbers (`lerobot/rollout/context.py`,
`observation_features_hw`).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.validation import finite_number
from lerobot_robot_yam.face.devices.device_session import DeviceSession
from lerobot_robot_yam.mobile.base_profile import CASTERS
from lerobot_robot_yam.session.base_client import BaseClient

VELOCITY_KEYS = ("x.vel", "y.vel", "theta.vel")
ODOMETRY_KEYS = ("x.pos", "y.pos", "theta.pos")
WHEEL_KEYS = (*(f"{name}_steer.pos" for name in CASTERS), *(f"{name}_drive.vel" for name in CASTERS))
_UNITS = np.array([1.0, 1.0, np.degrees(1.0)])  # LeRobot's numbers in SI units: m, m, degrees


def optional_keys(odometry: bool, wheels: bool) -> list[str]:
    """Return the keys of the optional numbers that are enabled."""
    return [*ODOMETRY_KEYS * odometry, *WHEEL_KEYS * wheels]


class BasePart:
    """The base of a device.

    Args:
        session: the session of the device, of which the base is a part.
        name: the base's name in the session.
        odometry, wheels: whether these are observed.

    Attributes:
        action_keys: keys of the base's part of an action.
        extra_keys: keys of the optional numbers.
    """

    def __init__(self, session: DeviceSession, name: str, odometry: bool, wheels: bool):
        self._session, self._name = session, name
        self._odometry, self._wheels = odometry, wheels
        self.action_keys = list(VELOCITY_KEYS)
        self.extra_keys = optional_keys(odometry, wheels)

    @property
    def client(self) -> BaseClient:
        """Client of the base. Raises LifeCycleError: the device is not connected."""
        return self._session.base(self._name)

    def target(self, action: Mapping[str, Any]) -> np.ndarray:
        """Return the twist (3,), m/s, m/s, rad/s, that an action asks for.

        Raises:
            ActionError: a value is not a finite number.
        """
        return np.array([finite_number(self._name, key, action[key]) for key in VELOCITY_KEYS]) / _UNITS

    def send(self, twist: np.ndarray) -> dict[str, float]:
        """Send a twist (3,), m/s, m/s, rad/s; return what was sent as an action.

        Raises:
            YamError: the base has failed or is silent; nothing was sent.
        """
        return _named(VELOCITY_KEYS, self.client.write_velocity(twist) * _UNITS)

    def observe(self) -> dict[str, float]:
        """Return the newest state by key. Raises YamError: the base has failed or is silent."""
        state = self.client.observe()
        seen = _named(VELOCITY_KEYS, state.body_twist * _UNITS)
        if self._odometry:
            seen |= _named(ODOMETRY_KEYS, state.pose * _UNITS)
        if self._wheels:
            seen |= _named(WHEEL_KEYS, np.concatenate([state.steer_rad, state.drive_rad_s]))
        return seen


def _named(keys: tuple[str, ...], values: np.ndarray) -> dict[str, float]:
    return dict(zip(keys, values.tolist(), strict=True))
