"""The base of a LeRobot robot: keys, units, and conversions between LeRobot's numbers and the base's.

    x.vel, y.vel, theta.vel          velocity in the body's frame, m/s, m/s, deg/s: actions and, measured, observations
    x.pos, y.pos, theta.pos          odometry, m, m, deg (option observe_odometry)
    height.vel or height.pos         with a rail, m/s or m, as the option rail_action says; height.pos is always seen
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
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_robot_yam.arm.validation import finite_number
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.face.devices.device_session import DeviceSession
from lerobot_robot_yam.face.lerobot_command.running_command import policy_pauses
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.base_profile import CASTERS
from lerobot_robot_yam.session.base_client import BaseClient

if TYPE_CHECKING:
    from lerobot_robot_yam.face.devices.replayed_path import ReplayedPath

logger = logging.getLogger(__name__)

VELOCITY_KEYS = ("x.vel", "y.vel", "theta.vel")
ODOMETRY_KEYS = ("x.pos", "y.pos", "theta.pos")
WHEEL_KEYS = (*(f"{name}_steer.pos" for name in CASTERS), *(f"{name}_drive.vel" for name in CASTERS))
HEIGHT, HEIGHT_RATE = "height.pos", "height.vel"
_UNITS = np.array([1.0, 1.0, np.degrees(1.0)])  # LeRobot's units per SI unit: m, m, degrees


def action_keys(rail_action: str | None) -> list[str]:
    """Return the keys of the base's part of an action. rail_action: "vel" or "pos"; None without a rail."""
    return [*VELOCITY_KEYS, *([] if rail_action is None else [f"height.{rail_action}"])]


def extra_keys(rail_action: str | None, odometry: bool, wheels: bool) -> list[str]:
    """Return the keys of the other numbers that are observed. odometry, wheels: whether these are enabled."""
    return [*[HEIGHT] * (rail_action == "vel"), *ODOMETRY_KEYS * odometry, *WHEEL_KEYS * wheels]


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
        config: the base.
        keys: keys of the base's part of an action, see `action_keys`.
        extra: keys of the other numbers, see `extra_keys`.
    """

    def __init__(self, session: DeviceSession, config: BaseConfig, keys: Sequence[str], extra: Sequence[str]):
        self._session, self._config, self._name = session, config, config.name
        self.keys, self.extra_keys = list(keys), list(extra)
        self._rests = False
        self._path: ReplayedPath | None = None

    @property
    def client(self) -> BaseClient:
        """Client of the base. Raises LifeCycleError: the device is not connected."""
        return self._session.base(self._name)

    def begin(self, path: "ReplayedPath | None") -> None:
        """Begin a session. path: recorded poses that the actions to come belong to."""
        self._path, self._rests = path, False

    @property
    def calibrated(self) -> bool:
        """Whether the rail is homed, or, before connecting, whether its file is there. True without a rail."""
        if self._config.rail is None:
            return True
        if self._session.connected:
            rail = self.client.published().rail
            return rail is not None and rail.homed
        return self._config.rail.stored

    def check_homed(self) -> None:
        """Raise LifeCycleError if the rail is not homed: its height would be no number."""
        if not self.calibrated:
            raise LifeCycleError(
                f"{self._name}: the rail is not homed, and nothing homes by itself: run lerobot-calibrate on the "
                "robot's own computer, with the rail's way free; end a yam-host there first"
            )

    def calibrate(self) -> None:
        """Home the rail. Raises YamError: homing failed; the brake holds."""
        if self._config.rail is None:
            logger.info("%s: a base without a rail has nothing to calibrate", self._name)
            return
        self.client.home_rail()
        logger.info("%s: the rail is homed; stored in %s", self._name, self._config.rail.calibration_path)

    def target(self, action: Mapping[str, Any]) -> np.ndarray:
        """Return the values of an action, (3,) twist in m/s, m/s, rad/s; with a rail (4,), the last in m/s or m.

        Raises:
            ActionError: a value is not a finite number.
            LifeCycleError: the rail is not homed.
            YamError: the base has failed or is silent.
        """
        self.client.observe()
        self.check_homed()
        values = np.array([finite_number(self._name, key, action[key]) for key in self.keys])
        values[:3] /= _UNITS
        return values

    def send(self, values: np.ndarray, rests: bool = False) -> dict[str, float]:
        """Send what `target` has returned; return what was sent as an action.

        Args:
            rests: whether velocity zero is sent instead. It is also sent while a rollout pauses.

        Raises:
            YamError: the base has failed or is silent; nothing was sent.
        """
        rested, self._rests = self._rests, rests or policy_pauses()
        if self._rests and not rested:
            logger.info("%s: stands while LeRobot pauses", self._name)
        if self._path is not None:
            values = self._path.correct(values, self.client.observe())
        if self._rests:
            values = np.where([key.endswith(".vel") for key in self.keys], 0.0, values)
        sent: dict[str, float] = {}
        if HEIGHT_RATE in self.keys:
            sent[HEIGHT_RATE] = self.client.write_rail_velocity(values[3])
        elif HEIGHT in self.keys:
            sent[HEIGHT] = self.client.write_rail_height(values[3])
        return _named(VELOCITY_KEYS, self.client.write_velocity(values[:3]) * _UNITS) | sent

    def observe(self) -> dict[str, float]:
        """Return the newest state by key. Raises YamError: the base has failed or is silent; its rail has to home."""
        state = self.client.observe()
        if state.rail is not None and not state.rail.homed:
            self.check_homed()  # a height that is unknown is no number to record
        seen = _named(VELOCITY_KEYS, state.body_twist * _UNITS) | _named(ODOMETRY_KEYS, state.pose * _UNITS)
        seen |= _named(WHEEL_KEYS, np.concatenate([state.steer_rad, state.drive_rad_s]))
        if state.rail is not None:
            seen |= {HEIGHT: state.rail.height_m, HEIGHT_RATE: state.rail.velocity_m_s}
        return {key: seen[key] for key in (*self.keys, *self.extra_keys)}


def _named(keys: tuple[str, ...], values: np.ndarray) -> dict[str, float]:
    return dict(zip(keys, values.tolist(), strict=True))
