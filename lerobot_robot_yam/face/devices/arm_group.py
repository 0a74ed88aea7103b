"""One or two arms of a LeRobot device: feature names, units, calibration files, connect and land."""

import contextlib
import logging
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig, lead_of
from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.face.devices.device_session import DeviceSession, connected_sessions
from lerobot_robot_yam.face.devices.feature_names import motor_names
from lerobot_robot_yam.face.devices.pair_check import Models, Spoken, check_followers, check_pair
from lerobot_robot_yam.face.lerobot_command.running_command import under_a_command
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.target_limits import refuse_degrees, validate_action
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.records import channel_key

logger = logging.getLogger(__name__)

Recognise = Callable[[Mapping[str, object]], tuple[np.ndarray, list[bool]] | None]


class _Side:
    """Arm of the group, and the indices of its values in the group's vector."""

    def __init__(self, prefix: str, config: ArmConfig, session: ArmSession, start: int, handles: bool):
        self.name = config.name
        self.prefix = prefix
        self.hardware = hardware = session.hardware(config.name)
        self.joints = hardware.joints
        self.has_gripper = hardware.has_gripper or (handles and hardware.gripper.handle_encoder)
        self.motors = motor_names(prefix, self.joints, self.has_gripper)
        self.slice = slice(start, start + self.joints)
        self.gripper_index = start + self.joints if self.has_gripper else None
        self.values = slice(start, start + len(self.motors))
        self.key = session.key(config.name)
        lead = lead_of(config)
        rig = hardware.config.can_options.get("rig")
        self.follower_key = None if lead is None else channel_key(config.interface, lead.follower, rig)


class ArmGroup(DeviceSession):
    """The arms of one LeRobot device, driven by one control loop.

    Args:
        device: LeRobot's type name, for messages.
        arms: feature prefix → configuration, in canonical order: {"": …} or {"left_": …, "right_": …}.
        use_degrees: whether LeRobot's joint values are in degrees; grippers stay 0 … 1.
        isolation: where the control loop runs, see `ArmSession`.
        handles: for leaders, prefixes of arms whose trigger counts as a gripper, if they have a handle; None for
            followers.
        base: the base on which the arms ride, if any.

    Attributes:
        motors: names of the values in canonical order, such as `left_joint_1`.
        keys: keys of an action: the same names with `.pos`.
        base_config: the base on which the arms ride, if any.
        is_joint: (n,) whether each value is an angle; the other values are gripper openings.
        paused: whether followers hold until they get a new target, see `pause_followers`.
        give_action: for connected leaders, function that returns their current action; None for followers.
        take_overs: for leaders, prefix of an arm → (number of the button from 1, presses known) by which a person takes
            its follower over within the control loop, while a policy drives it; see `Led`.
        recognise: for connected leaders, function that takes an action and returns (joints, same), or None if no arm's
            part of it is that of their last action. joints: joints (n,) of their last action. same: for each arm,
            whether its part is the same in both actions. None for followers.
    """

    def __init__(
        self,
        device: str,
        arms: Mapping[str, ArmConfig],
        use_degrees: bool,
        isolation: Isolation,
        handles: Collection[str] | None = None,
        base: BaseConfig | None = None,
    ):
        self._configs, self.base_config = list(arms.values()), base
        super().__init__(device, [*self._configs, *([] if base is None else [base])], isolation)
        self._use_degrees, self._leads = use_degrees, handles is not None
        self.sides: list[_Side] = []
        self.motors: list[str] = []
        for prefix, config in arms.items():
            side = _Side(prefix, config, self._session, len(self.motors), prefix in (handles or ()))
            self.sides.append(side)
            self.motors += side.motors
        self.keys = [f"{motor}.pos" for motor in self.motors]
        self.is_joint = np.array([not motor.endswith("gripper") for motor in self.motors])
        self._action_keys: list[str] = []  # set while connected
        self._models: Models = []
        self.scale = np.where(self.is_joint & use_degrees, 180.0 / math.pi, 1.0)
        limits = [(side.hardware.lower[: side.joints], side.hardware.upper[: side.joints]) for side in self.sides]
        self._lower, self._upper = (np.concatenate(column) for column in zip(*limits, strict=True))
        self.paused = False
        self.give_action: Callable[[], Mapping[str, float]] | None = None
        self.recognise: Recognise | None = None
        self.take_overs: dict[str, tuple[int, int]] = {}

    def __getitem__(self, side: _Side) -> ArmClient:
        return self._session[side.name]

    @property
    def calibrated(self) -> bool:
        """Whether all grippers' stops are configured, stored, or known to the control loop, which will store them."""
        return all(
            config.gripper_stops_rad is not None
            or Path(config.calibration_path or "").is_file()
            or (self.connected and self[side].published().gripper_stops_rad is not None)
            for config, side in zip(self._configs, self.sides, strict=True)
            if side.hardware.has_gripper
        )

    def start(
        self,
        calibrate: bool,
        action_keys: Sequence[str],
        models: Models,
        give_action: Callable[[], Mapping[str, float]] | None = None,
        recognise: Recognise | None = None,
    ) -> None:
        """Energise all arms or none.

        Args:
            calibrate: False before a calibration (lerobot-calibrate): stops of grippers are not searched for, and known
                stops that do not fit are ignored.
            action_keys: keys of the device's actions; a leader and a follower in one process need the same keys.
            models: profiles that the actions refer to; a leader and a follower in one process need matching profiles.
            give_action, recognise: functions of a leader, see `ArmGroup`.

        Raises:
            YamError: an arm cannot be driven; no arm is energised.
        """
        self._action_keys, self._models, self.paused = list(action_keys), models, False
        self.take_overs = {}
        self.give_action, self.recognise = give_action, recognise
        for other in _running():
            if other._leads is not self._leads:
                self._check_pair(other)
        self.energise(search_grippers=calibrate)

    def _check_pair(self, other: "ArmGroup") -> None:
        """Raise ConfigError if actions of leader and follower do not match, before the arms are energised."""
        check_pair(*(Spoken(g.device, g._action_keys, g._use_degrees, g._models) for g in (self, other)))
        both = f"{self.device} and {other.device}"
        leaders, followers = (self, other) if self._leads else (other, self)
        for leader, follower in zip(leaders.sides, followers.sides, strict=True):
            if leader.follower_key not in (None, follower.key):
                raise ConfigError(
                    f"{both}: {leader.name} leads {leader.follower_key}, but LeRobot gives its action to "
                    f"{follower.name} on {follower.key}; set its option follower to that one's channel"
                )

    def check_followers(self) -> None:
        """Raise if this process cannot lead a follower, as `pair_check.check_followers` does."""
        others = [side.key for other in _running() if not other._leads for side in other.sides]
        if any(side.follower_key for side in self.sides):
            check_followers([side.hardware.config for side in self.sides], others)

    def calibrate(self) -> None:
        """Search for the stops of gripper motors and store them, see `ArmDevice.calibrate`."""
        for side, config in zip(self.sides, self._configs, strict=True):
            if side.hardware.has_gripper:
                self[side].calibrate_gripper()
                logger.info("%s: gripper stops stored in %s", side.name, config.calibration_path)
            elif side.hardware.gripper.handle_encoder and config.calibration_path is not None:
                self[side].calibrate_trigger()
                logger.info("%s: the trigger's range is stored in %s", side.name, config.calibration_path)
            else:
                logger.info("%s: nothing to calibrate, there is no gripper motor", side.name)

    def leader(self) -> "ArmGroup | None":
        """Return the leaders whose actions a LeRobot command sends to these followers, if there is exactly one pair."""
        leaders = [other for other in _running() if other.give_action is not None]
        one_pair = len(leaders) == 1 and len(_running()) == 2
        return leaders[0] if one_pair and under_a_command() else None

    def couple(
        self, action: Mapping[str, object], joints_of: Callable[[Mapping[str, object]], np.ndarray]
    ) -> tuple[np.ndarray, list[str | None]] | None:
        """Find the leaders of this process that produced an action, so that followers can follow them at loop rate.

        Args:
            action: action of all arms; the values of one arm may come from a leader, those of the other from elsewhere.
            joints_of: function that computes the joints (n,) of an action that comes at least partly from elsewhere.

        Returns:
            (joints, keys), or None if no leader has produced the action. joints: joints (n,) of the action. keys: for
            each arm, the channel key of its leader; None if that leader has no follower or has not produced the arm's
            part of the action.
        """
        for other in _running():
            if other.recognise is None or not any(side.follower_key for side in other.sides):
                continue
            recognised = other.recognise(action)
            if recognised is None or len(other.sides) != len(self.sides):
                continue
            target, same = recognised
            if not all(same):
                given, target = target, joints_of(action)
                for side, is_given in zip(self.sides, same, strict=True):
                    if is_given:
                        target[side.values] = given[side.values]
            pairs = zip(other.sides, same, strict=True)
            return target, [side.key if side.follower_key and is_given else None for side, is_given in pairs]
        return None

    def leader_at_hand(self, side: _Side) -> tuple[str, tuple[int, int]]:
        """Return (channel key, take-over) of the leader that may take over the follower `side`; ("", (0, 0)): none."""
        for other in _running():
            for leader in other.sides:
                if leader.follower_key == side.key and leader.prefix in other.take_overs:
                    return leader.key, other.take_overs[leader.prefix]
        return "", (0, 0)

    def follower_state(self, key: str) -> ArmState | None:
        """Return the state of the follower with this channel key; None if it is not in this process, or is in fault."""
        for other in _running():
            for side in other.sides:
                if side.key == key and not other._leads:
                    with contextlib.suppress(YamError):
                        return other[side].newest()
        return None

    def follower_opening(self) -> float:
        """Return the first follower's target opening, 0 closed … 1 open; 1 without a gripper or follower."""
        states = [other.newest()[0] for other in _running() if not other._leads]
        opening = states[0].gripper_setpoint if states else None
        return 1.0 if opening is None else opening

    def pause_followers(self) -> None:
        """Make the followers of this process brake and hold until a target differs from the last one.

        Called before a held leader is moved to a follower's pose: LeRobot pauses at that time, but still sends its last
        action.
        """
        for other in _running():
            if not other._leads:
                other._hold()

    @staticmethod
    def resume_followers() -> None:
        """End the pause: followers accept any target again."""
        for other in _running():
            other.paused = False

    def _hold(self) -> None:
        logger.info("%s: holds until another target comes than the last one", self.device)
        self.paused = True
        for side in self.sides:
            with contextlib.suppress(YamError):  # a failed arm raises at its next observation
                self[side].hold()
        if self.base_config is not None:
            with contextlib.suppress(YamError):
                self.base(self.base_config.name).hold()

    def held(self) -> np.ndarray:
        """Return the set-points of all arms, (n,) in canonical order, rad; grippers 0 closed … 1 open.

        Raises:
            YamError: an arm is silent or in fault.
        """
        return np.array([value for state in self.newest() for value in state.setpoints])

    def observe(self) -> list[ArmState]:
        """Return a fresh state of each arm. Raises YamError: an arm is silent or in fault."""
        for side in self.sides:
            self[side].await_fresh()
        return self.newest()

    def newest(self) -> list[ArmState]:
        """Return the newest state of each arm without waiting, for modes and set-points. Raises as `observe` does."""
        return [self[side].newest() for side in self.sides]

    def vector(self, action: Mapping[str, object]) -> np.ndarray:
        """Return the values of a LeRobot action in canonical order and SI units, (n,).

        Raises:
            ActionError: keys are missing or unknown, values are not finite, or values are degrees instead of radians.
        """
        vector = validate_action(self.device, action, self.keys) / self.scale
        if not self._use_degrees:
            refuse_degrees(self.device, vector[self.is_joint], self._lower, self._upper)
        return vector

    def action(self, vector: np.ndarray) -> dict[str, float]:
        """Convert a vector in canonical order and SI units to a LeRobot action."""
        return dict(zip(self.keys, (vector * self.scale).tolist(), strict=True))

    def begin(self) -> None:
        """Do nothing: joints can be moved from any pose."""


def _running() -> list[ArmGroup]:
    """Return the connected groups of this process."""
    return [session for session in connected_sessions if isinstance(session, ArmGroup)]
