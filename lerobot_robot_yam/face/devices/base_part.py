"""The base of a LeRobot robot: keys, units, and conversions between LeRobot's numbers and the base's.

    x.vel, y.vel, theta.vel          velocity in the body's frame, m/s, m/s, deg/s: actions and, measured, observations
    x.pos, y.pos, theta.pos          odometry, m, m, deg (option observe_odometry)
    rear_left_steer.pos …            angles of the casters, rad (option observe_wheels)
    rear_left_drive.vel …            rates of the wheels, rad/s (option observe_wheels)

All names end in .pos or .vel, since lerobot-rollout drops other numbers (`lerobot/rollout/context.py`,
`observation_features_hw`).

Two habits of LeRobot suit arms, not bases:

- While a rollout with corrections pauses, LeRobot repeats or fades its last action (`rollout/strategies/dagger.py`). An
  arm with the same target stays where it is, a base with the same velocity drives on: it rests, see `BasePart.send`.
- At the end of a rollout, LeRobot sends observed .pos values alone (`rollout/strategies/core.py`), see `completed`.
"""

import logging
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_robot_yam.arm.validation import finite_number
from lerobot_robot_yam.face.devices.device_session import DeviceSession
from lerobot_robot_yam.face.lerobot_command.running_command import policy_pauses
from lerobot_robot_yam.mobile.base_profile import CASTERS
from lerobot_robot_yam.session.base_client import BaseClient

if TYPE_CHECKING:
    from lerobot_robot_yam.face.devices.replayed_path import ReplayedPath

logger = logging.getLogger(__name__)

VELOCITY_KEYS = ("x.vel", "y.vel", "theta.vel")
ODOMETRY_KEYS = ("x.pos", "y.pos", "theta.pos")
WHEEL_KEYS = (*(f"{name}_steer.pos" for name in CASTERS), *(f"{name}_drive.vel" for name in CASTERS))
_UNITS = np.array([1.0, 1.0, np.degrees(1.0)])  # LeRobot's units per SI unit: m, m, degrees


def optional_keys(odometry: bool, wheels: bool) -> list[str]:
    """Return the keys of the optional numbers that are enabled."""
    return [*ODOMETRY_KEYS * odometry, *WHEEL_KEYS * wheels]


def completed(action: Mapping[str, Any], keys: Collection[str], observed: Collection[str]) -> Mapping[str, Any]:
    """Complete an action with which a rollout returns to its start; return any other action unchanged.

    The base stands meanwhile: LeRobot's straight way back may lead through whatever stands around.

    Args:
        keys: keys of the robot's actions.
        observed: keys of the robot's observations.
    """
    positions = {key for key in observed if key.endswith(".pos")}
    if not positions or positions == set(keys) or not isinstance(action, Mapping) or action.keys() != positions:
        return action
    return {key: action.get(key, 0.0) for key in keys}


class BasePart:
    """The base of a device.

    Args:
        session: the session of the device, of which the base is a part.
        name: the base's name in the session.
        keys: keys of the base's part of an action.
        extra_keys: keys of the optional numbers, see `optional_keys`.
    """

    def __init__(self, session: DeviceSession, name: str, keys: Collection[str], extra_keys: Collection[str]):
        self._session, self._name = session, name
        self.keys, self.extra_keys = list(keys), list(extra_keys)
        self._rests = False
        self._path: ReplayedPath | None = None

    @property
    def client(self) -> BaseClient:
        """Client of the base. Raises LifeCycleError: the device is not connected."""
        return self._session.base(self._name)

    def begin(self, path: "ReplayedPath | None") -> None:
        """Begin a session. path: recorded poses that the actions to come belong to."""
        self._path, self._rests = path, False

    def target(self, action: Mapping[str, Any]) -> np.ndarray:
        """Return the twist (3,), m/s, m/s, rad/s, that an action asks for.

        Raises:
            ActionError: a value is not a finite number.
            YamError: the base has failed or is silent.
        """
        self.client.observe()
        return np.array([finite_number(self._name, key, action[key]) for key in VELOCITY_KEYS]) / _UNITS

    def send(self, twist: np.ndarray, rests: bool = False) -> dict[str, float]:
        """Send a twist (3,), m/s, m/s, rad/s; return what was sent as an action.

        Args:
            rests: whether zero is sent instead. Zero is also sent while a rollout pauses.

        Raises:
            YamError: the base has failed or is silent; nothing was sent.
        """
        rested, self._rests = self._rests, rests or policy_pauses()
        if self._rests and not rested:
            logger.info("%s: stands while LeRobot pauses", self._name)
        if self._path is not None:
            twist = self._path.correct(twist, self.client.observe().pose)
        sent = self.client.write_velocity(np.zeros(3) if self._rests else twist)
        return _named(VELOCITY_KEYS, sent * _UNITS)

    def observe(self) -> dict[str, float]:
        """Return the newest state by key. Raises YamError: the base has failed or is silent."""
        state = self.client.observe()
        seen = _named(VELOCITY_KEYS, state.body_twist * _UNITS) | _named(ODOMETRY_KEYS, state.pose * _UNITS)
        seen |= _named(WHEEL_KEYS, np.concatenate([state.steer_rad, state.drive_rad_s]))
        return {key: seen[key] for key in (*self.keys, *self.extra_keys)}


def _named(keys: tuple[str, ...], values: np.ndarray) -> dict[str, float]:
    return dict(zip(keys, values.tolist(), strict=True))
