"""One arm or two behind a LeRobot device: names of the features, units, calibration files, connect and land."""

import atexit
import contextlib
import logging
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig, lead_of
from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.face.devices.feature_names import motor_names
from lerobot_robot_yam.face.devices.pair_check import Models, Spoken, check_followers, check_pair
from lerobot_robot_yam.face.lerobot_command.running_command import under_a_command
from lerobot_robot_yam.face.recorder.kept_episodes import stop_after_saving, tell_what_is_kept
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.target_limits import refuse_degrees, validate_action
from lerobot_robot_yam.state.records import ArmState, channel_key
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.system.realtime import spare_what_is_loaded
from lerobot_robot_yam.system.signals import end_session_on_signals, undisturbed

logger = logging.getLogger(__name__)

Recognise = Callable[[Mapping[str, object]], tuple[np.ndarray, list[bool]] | None]

_running: "list[ArmGroup]" = []  # connected groups of this process


class _Side:
    """Arm of the group, and the place of its values in the group's vector."""

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


class ArmGroup:
    """The arms of one LeRobot device, driven by one control loop.

    Args:
        device: LeRobot's type name, for messages.
        arms: feature prefix → configuration, in canonical order: {"": …} or {"left_": …, "right_": …}.
        use_degrees: whether joints are in degrees towards LeRobot; grippers stay 0 … 1.
        isolation: where the control loop runs, see `ArmSession`.
        handles: for leaders, prefixes of arms whose trigger counts as a gripper, if they have a handle; None for
            followers.

    Attributes:
        motors: names of the values in canonical order, such as `left_joint_1`.
        keys: keys of an action: these names with `.pos`.
        is_joint: (n,) whether each value is an angle; the others are openings of grippers.
        paused: whether followers hold until they get a new target, see `pause_followers`.
        give_action: for connected leaders, returns their present action; None for followers.
        recognise: for connected leaders, returns the joints (n,) of their last action, and for each arm whether a
            given action has them; None if the action has none of them.
    """

    def __init__(
        self,
        device: str,
        arms: Mapping[str, ArmConfig],
        use_degrees: bool,
        isolation: Isolation,
        handles: Collection[str] | None = None,
    ):
        self.device = device
        self._use_degrees, self._leads = use_degrees, handles is not None
        self._configs = list(arms.values())
        self._session = ArmSession(self._configs, isolation)
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
        self._undo_signals: Callable[[], None] = lambda: None

    def __getitem__(self, side: _Side) -> ArmClient:
        return self._session[side.name]

    @property
    def connected(self) -> bool:
        """Whether the device is connected, whatever state the arms are in."""
        return self._session.running

    @property
    def calibrated(self) -> bool:
        """Whether all grippers' stops are configured, stored, or known to the loop, which stores them soon."""
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
            calibrate: False before a calibration (lerobot-calibrate): the grippers' stops are not searched, and known
                stops that do not fit are set aside.
            action_keys: keys of the device's actions; a leader and a follower of one process need the same keys.
            models: profiles to which the actions refer; a leader and a follower of one process need matching profiles.
            give_action, recognise: functions of a leader, see `ArmGroup`.

        Raises:
            YamError: an arm cannot be driven; nothing is energised.
        """
        tell_what_is_kept()
        self._action_keys, self._models, self.paused = list(action_keys), models, False
        self.give_action, self.recognise = give_action, recognise
        for other in _running:
            if other._leads is not self._leads:
                self._check_pair(other)
        commanded = under_a_command()
        self._undo_signals = end_session_on_signals(stop_after_saving, commanded)
        if commanded:
            spare_what_is_loaded()
        try:
            self._session.start(search_grippers=calibrate)
        except BaseException:
            self._undo_signals()
            raise
        _running.append(self)
        atexit.register(self.stop)  # whatever ends the interpreter, the arms land

    def _check_pair(self, other: "ArmGroup") -> None:
        """Refuse a leader and a follower whose actions do not fit, before the arms are energised."""
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
        """Refuse followers that this process cannot lead; raises as `pair_check.check_followers` does."""
        others = [side.key for other in _running if not other._leads for side in other.sides]
        if any(side.follower_key for side in self.sides):
            check_followers([side.hardware.config for side in self.sides], others)

    def stop(self) -> None:
        """Land all arms and disconnect. Idempotent; signals do not cut the landing short.

        A LeRobot command that disconnects one device disconnects the others next, so all arms begin to land now.
        """
        self._leave()
        try:
            with undisturbed(f"{self.device}: landing"):
                if under_a_command():
                    for other in _running:
                        with contextlib.suppress(OSError):  # these arms land, whatever happens to the other process
                            other._session.begin_stop()
                self._session.stop()
        finally:
            self._undo_signals()

    def _leave(self) -> None:
        atexit.unregister(self.stop)
        if self in _running:
            _running.remove(self)

    @property
    def clock(self) -> Clock:
        return self._session.clock

    def discard(self) -> None:
        """End the session without landing, when its lock-step world is thrown away. Idempotent."""
        self._leave()
        try:
            self._session.discard()
        finally:
            self._undo_signals()

    def calibrate(self) -> None:
        """Search the stops of gripper motors and store them, see `ArmDevice.calibrate`."""
        for side, config in zip(self.sides, self._configs, strict=True):
            if side.hardware.has_gripper:
                self[side].calibrate_gripper()
                logger.info("%s: gripper stops stored in %s", side.name, config.calibration_path)
            elif side.hardware.gripper.handle_encoder and config.calibration_path is not None:
                self[side].calibrate_trigger()
                logger.info("%s: the trigger's range is stored in %s", side.name, config.calibration_path)
            else:
                logger.info("%s: nothing to calibrate, there is no gripper motor", side.name)

    def rearm(self) -> None:
        """Enable failed arms again, see `ArmDevice.rearm`."""
        self._session.rearm()

    def leader(self) -> "ArmGroup | None":
        """Return the leaders whose actions a LeRobot command gives to these followers, if there is one pair."""
        leaders = [other for other in _running if other.give_action is not None]
        one_pair = len(leaders) == 1 and len(_running) == 2
        return leaders[0] if one_pair and under_a_command() else None

    def couple(
        self, action: Mapping[str, object], joints_of: Callable[[Mapping[str, object]], np.ndarray]
    ) -> tuple[np.ndarray, list[str | None]] | None:
        """Find leaders of this process that gave this action last, so that followers can follow them at loop rate.

        Args:
            action: action of all arms; the values of one arm may come from a leader, and of the other from elsewhere.
            joints_of: computes the joints (n,) of other sources.

        Returns:
            The joints (n,) of the action, and for each arm the channel key of its leader, None if that leader has no
            follower or has not given the action. None in place of both if no leader has given the action.
        """
        for other in _running:
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

    def follower_state(self, key: str) -> ArmState | None:
        """Return the state of the follower with this channel key; None if it is not in this process, or has failed."""
        for other in _running:
            for side in other.sides:
                if side.key == key and not other._leads:
                    with contextlib.suppress(YamError):
                        return other[side].newest()
        return None

    def follower_opening(self) -> float:
        """Return the first follower's target opening, 0 closed … 1 open; 1 without a gripper or follower."""
        states = [other.newest()[0] for other in _running if not other._leads]
        opening = states[0].gripper_setpoint if states else None
        return 1.0 if opening is None else opening

    def pause_followers(self) -> None:
        """Have the followers of this process brake and hold until a target comes that differs from the last one.

        Called when a held leader is about to be led to a follower: LeRobot pauses then, but still sends its last
        action.
        """
        for other in _running:
            if not other._leads:
                other._hold()

    @staticmethod
    def resume_followers() -> None:
        """End the pause: followers accept any target."""
        for other in _running:
            other.paused = False

    def _hold(self) -> None:
        logger.info("%s: holds until another target comes than the last one", self.device)
        self.paused = True
        for side in self.sides:
            with contextlib.suppress(YamError):  # a failed arm raises at its next observation
                self[side].hold()

    def held(self) -> np.ndarray:
        """Return the set-points of all arms, (n,) in canonical order, rad; grippers 0 closed … 1 open.

        Raises:
            YamError: an arm is silent or has failed.
        """
        return np.array([value for state in self.newest() for value in state.setpoints])

    def observe(self) -> list[ArmState]:
        """Return a fresh state of each arm. Raises YamError: an arm is silent or has failed."""
        for side in self.sides:
            self[side].await_fresh()
        return self.newest()

    def newest(self) -> list[ArmState]:
        """Return the newest state of each arm without waiting, for modes and set-points; raises as `observe` does."""
        return [self[side].newest() for side in self.sides]

    def vector(self, action: Mapping[str, object]) -> np.ndarray:
        """Return the values of a LeRobot action in canonical order and SI units, (n,).

        Raises:
            ActionError: keys are missing or unknown, values are not finite, or are degrees instead of radians.
        """
        vector = validate_action(self.device, action, self.keys) / self.scale
        if not self._use_degrees:
            refuse_degrees(self.device, vector[self.is_joint], self._lower, self._upper)
        return vector

    def action(self, vector: np.ndarray) -> dict[str, float]:
        """Return LeRobot's form of a vector in canonical order and SI units."""
        return dict(zip(self.keys, (vector * self.scale).tolist(), strict=True))

    def begin(self) -> None:
        """Do nothing: joints move from any pose."""
