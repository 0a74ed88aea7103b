"""Leader arms on this computer or another one, as a LeRobot teleoperator."""

import logging
import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.teleoperators.utils import TeleopEvents
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.control.teleop.follower_target import TriggerPickup
from lerobot_robot_yam.face.devices.arm_device import ArmDevice
from lerobot_robot_yam.face.devices.remote_device import RemoteDevice
from lerobot_robot_yam.face.lerobot_command.running_command import command_above
from lerobot_robot_yam.face.operator_keys.operator_keys import OperatorKeys
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.face.rl_stack import TeleopEventWatch, ToolSteps
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import coupling_number
from lerobot_teleoperator_yam.config_yam_leader import (
    BiYamLeaderConfig,
    BiYamRemoteLeaderConfig,
    YamLeaderConfig,
    YamRemoteLeaderConfig,
)
from lerobot_teleoperator_yam.leader_options import LeaderOptions, meanings_of

logger = logging.getLogger(__name__)

_OPEN = 1.0
_ROUNDED = 1e-4  # maximum change of an action by rounding, rad, m or strokes: four decimals, or float32
_FOREIGN = 10  # number of successive actions from elsewhere that are reported

_GATE_WORDS = {
    Gate.HOMING: "going home",
    Gate.IDLE: "ready",
    Gate.APPROACH: "approaching",
    Gate.ENGAGED: "engaged",
    Gate.FINE: "fine mode",
    Gate.RECENTRE: "recentring",
}


class GateVoice:
    """Announces gate changes by LeRobot's voice if `play_sounds` is on. `together`: once for all leaders."""

    def __init__(self, together: bool):
        self._together = together
        self._say: Callable[[str], None] | None = None
        self._before: dict[str, Gate] = {}

    def begin(self) -> None:
        """Start a session. The voice speaks if the running command plays sounds."""
        self._say, self._before = None, {}
        command = command_above()
        if command is not None and getattr(command[1], "play_sounds", False):
            # no extra import cost: the running LeRobot command has already imported this module
            from lerobot.utils.utils import say

            self._say = say

    def tell(self, gates: Mapping[str, Gate]) -> None:
        """Announce the gates (by prefix) that have changed since the last call, without waiting."""
        if self._say is None:
            return
        if self._together:
            if len(set(gates.values())) > 1:  # the second leader changes one tick later
                return
            gates = {"": next(iter(gates.values()))}
        for prefix, gate in gates.items():
            if self._before.get(prefix, gate) is not gate:
                self._say(f"{prefix.replace('_', ' ')}{_GATE_WORDS[gate]}")
        self._before = dict(gates)


class LeaderBase(ArmDevice, Teleoperator):
    """Teleoperator with one or two leader arms, which float until `enable_torque`.

    Args:
        config: `YamLeaderConfig` or `BiYamLeaderConfig`.
    """

    def __init__(self, config: Any):
        super().__init__(config)
        self.config = config
        options: LeaderOptions = config
        arms = options.arms()
        followers = [resolve_profiles(arm.follower_arm or arm.arm, arm.ee_gripper) for arm in arms.values()]
        handles = {prefix for prefix, (_, gripper) in zip(arms, followers, strict=True) if gripper.motor is not None}
        joints_in_degrees = options.use_degrees and options.action_space == "joint"
        self._arms = self._make_arms("leader", arms, joints_in_degrees, options.runs(), handles)
        self._lower, self._upper = np.zeros(len(self._arms.keys)), np.ones(len(self._arms.keys))
        for side, (follower, _) in zip(self._arms.sides, followers, strict=True):
            if side.joints:
                self._lower[side.slice], self._upper[side.slice] = follower.joint_limits_rad.T
        self._steps: ToolSteps | None = None
        if options.action_space == "delta":
            self._steps = ToolSteps(self._arms, followers, options.step_m, self._arms.follower_opening)
        self._speak("joint" if options.action_space == "delta" else options.action_space, followers)
        self._keys = OperatorKeys(meanings_of(options), options.auto_episodes)
        self._voice = GateVoice(together=all(arm.gate_together for arm in arms.values()))
        self._events = TeleopEventWatch(meanings_of(options), self.arm_states)
        self._restart()

    def _restart(self) -> None:
        """Reset the state left by the previous session."""
        self._action: dict[str, float] | None = None
        self._given = False  # whether get_action has returned an action since the last action sent to a follower
        self._foreign = 0  # number of successive actions from elsewhere
        self._target: np.ndarray = np.zeros(len(self._arms.keys))  # joints of _action
        self._was_held = self._follows_feedback = False
        self._pickups = [TriggerPickup() for _ in self._arms.sides]

    @cached_property
    def action_features(self) -> dict[str, Any]:
        """Features of an action, as in `ArmDevice`; with `action_space: delta` the features of LeRobot's RL stack."""
        return super().action_features if self._steps is None else self._steps.features

    @cached_property
    def feedback_features(self) -> dict[str, Any]:
        """Types of feedback values: joints, or end-effector poses as in actions. Feedback moves the leader."""
        return dict.fromkeys(self._space.keys, float)

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Energise all arms; they float, with gravity compensated. After an error no arm is energised.

        Raises:
            YamError: an arm cannot be driven, actions of this leader do not match the follower in this process, or the
                option `follower` names an arm that this leader cannot lead.
        """
        self._restart()
        self._arms.check_followers()
        self._voice.begin()
        keys = list(self.action_features) if self._steps is None else self._steps.keys
        self._arms.start(calibrate, keys, self._models, self.get_action, self._recognise)
        try:
            if self._steps is None:  # the RL stack reads events instead of keys
                self._keys.start(self.arm_states)
        except BaseException:
            self.disconnect()
            raise
        logger.info("%s connected", self)

    def arm_states(self) -> dict[str, ArmState]:
        """Return the last published state of each leader, by feature prefix ("", or "left_" and "right_")."""
        return {side.prefix: self._arms[side].published() for side in self._arms.sides}

    def let_take_over(self, known: Mapping[str, tuple[int, int]]) -> None:
        """Let a person take over the followers of these arms within the control loop, while a policy drives them.

        known: prefix of an arm → (number of its button from 1, presses of this button that the caller has seen). One
            press more makes the follower follow this leader, until its next target.
        """
        self._arms.take_overs = dict(known)

    def disconnect(self) -> None:
        """Land the arms, then write the last labels. Idempotent."""
        self._keys.end()
        try:
            self._arms.stop()
        finally:
            self._events.stop()
            self._keys.stop()

    @check_if_not_connected
    @saves_finished_episode
    def get_action(self) -> dict[str, float]:
        """Return the action at the leaders' pose, clamped to the follower's limits, so that recordings match it.

        With `action_space: ee` the action is the end-effector pose of the follower at the leader's joints.

        The gripper is open (1) while the trigger is released, and closed (0) while it is squeezed. While a handle is
        silent, its last opening stays (open before the first report). No motor moves a trigger, so an opening from
        feedback stays until the trigger has reached that opening: a person who takes over does not drop the object in
        the follower's gripper. During an emergency stop the last action stays, because the followers hold.

        Raises:
            MotorError: a motor has failed.
            StaleStateError: an arm has no recent data.
        """
        states = self._arms.observe()
        self._voice.tell({side.prefix: state.gate for side, state in zip(self._arms.sides, states, strict=True)})
        self._given = True
        if self._action is not None and any(state.mode is Mode.STOPPED for state in states):
            return dict(self._action)
        values: list[float] = []
        for side, state, pickup in zip(self._arms.sides, states, self._pickups, strict=True):
            led = None if side.follower_key is None or self._steps else self._led(side.key, side.follower_key, state)
            if led is not None:
                values += led[: len(side.motors)]
                continue
            values += state.q.tolist()
            if side.has_gripper and state.gripper is not None:
                values.append(state.gripper)
            elif side.has_gripper:
                if self._follows_feedback:
                    pickup.leave(_asked(pickup), _trigger(state))
                else:
                    pickup.advance(_trigger(state))
                values.append(_asked(pickup))
        self._target = np.minimum(np.maximum(values, self._lower), self._upper)
        if self._steps is not None and not self._events.intervenes():
            self._steps.begin()
        self._action = (self._steps or self._space).action(self._target)
        return dict(self._action)

    @check_if_not_connected
    def get_teleop_events(self) -> dict[TeleopEvents, bool]:
        """Return LeRobot's RL events: who drives, how the episode ends. Raises StaleStateError: an arm is silent."""
        return self._events.take()

    def _led(self, key: str, follower_key: str, state: ArmState) -> tuple[float, ...] | None:
        """Return the target of an arm's follower: the executed target if coupled, else the gate's; None: no follower.

        A follower whose state the leader's loop has not received yet stays where it is.
        """
        follower = self._arms.follower_state(follower_key)
        if follower is not None and follower.coupled_to == coupling_number(key):
            return follower.action
        return state.action or (None if follower is None else follower.setpoints)

    def _recognise(self, action: Mapping[str, Any]) -> tuple[np.ndarray, list[bool]] | None:
        """Return the joints of the last action, and per arm whether `action` repeats its part; None if no part.

        Each action is recognised once: a caller that repeats an action later wants the old pose, not the leader's
        current pose. One arm's part may come from the leader and the other arm's part from a policy.
        """
        given = self._action
        if given is None or not self._given or given.keys() != action.keys():
            return None
        most = _ROUNDED * float(self._arms.scale.max())
        changed = [key for key, value in given.items() if not _differ_by(action[key], value) <= most]
        same = [not any(key.startswith(side.prefix) for key in changed) for side in self._arms.sides]
        self._given = False
        self._foreign = 0 if any(same) else self._foreign + 1
        if self._foreign == _FOREIGN:
            what = "%s: LeRobot sends another %s than this leader's, so its follower follows at LeRobot's rate"
            logger.info(what, self, " and ".join(changed[:2]))
        return (self._target, same) if any(same) else None

    @check_if_not_connected
    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Move the arms to `feedback` (keys as in the action) while torque is enabled; ignored while the arms float.

        Raises:
            ActionError: keys or values are wrong; nothing was sent to any arm.
        """
        if not self._follows_feedback:
            return
        vector = self._space.vector(feedback)
        if any(self._arms[side].mode() is Mode.FLOAT for side in self._arms.sides):
            logger.warning("%s: floats since the emergency stop was released; feedback is ignored", self)
            self._follows_feedback = False
            return
        for side, pickup in zip(self._arms.sides, self._pickups, strict=True):
            gripper = None if side.gripper_index is None else min(max(float(vector[side.gripper_index]), 0.0), 1.0)
            if gripper is not None:
                pickup.leave(gripper, math.nan)
            self._arms[side].write_target(vector[side.slice], gripper if side.hardware.has_gripper else None)

    @check_if_not_connected
    def enable_torque(self) -> None:
        """Hold the current pose, and follow `send_feedback` from now on. Followers hold until a new target arrives."""
        self._arms.pause_followers()
        for side in self._arms.sides:
            self._arms[side].hold()
        for pickup in self._pickups:
            pickup.leave(_asked(pickup), math.nan)  # releasing the trigger during the hold drops nothing
        self._was_held = self._follows_feedback = True

    @check_if_not_connected
    def disable_torque(self) -> None:
        """Let the arms float with gravity compensated, never limp. Feedback is ignored from now on."""
        self._follows_feedback = False
        self._arms.resume_followers()
        for side in self._arms.sides:
            self._arms[side].float()
        for index, state in enumerate(self._arms.observe()):
            opening = _asked(self._pickups[index])
            if not self._was_held:  # the arms already floated: there was no handover
                self._pickups[index] = TriggerPickup()
                self._pickups[index].opening = opening
            elif state.trigger is not None:  # the trigger counts once it has reached the opening
                self._pickups[index].leave(opening, state.trigger)
        self._was_held = False


def _differ_by(value: Any, given: float) -> float:
    """Return the difference between the values of an action; NaN if `value` is no number."""
    try:
        return abs(float(value) - given)
    except (TypeError, ValueError):
        return math.nan


def _trigger(state: ArmState) -> float:
    return math.nan if state.trigger is None else state.trigger


def _asked(pickup: TriggerPickup) -> float:
    """Return the opening that a trigger requests; open before the trigger's first report."""
    return _OPEN if pickup.opening is None else pickup.opening


class YamLeader(LeaderBase):
    """One YAM arm moved by hand."""

    config_class = YamLeaderConfig
    name = "yam_leader"


class BiYamLeader(LeaderBase):
    """Two YAM arms moved by hand; one control loop drives both in step."""

    config_class = BiYamLeaderConfig
    name = "bi_yam_leader"


class YamRemoteLeader(RemoteDevice, YamLeader):
    """One YAM arm on another computer, moved by hand."""

    config_class = YamRemoteLeaderConfig


class BiYamRemoteLeader(RemoteDevice, BiYamLeader):
    """Two YAM arms on another computer, moved by hand."""

    config_class = BiYamRemoteLeaderConfig


# LeRobot looks up the devices of the spare types in this module
I2rtYamLeader, BiI2rtYamLeader = YamLeader, BiYamLeader
