"""What LeRobot's RL stack (`lerobot.rl`) asks of a robot's bus, answered from the arm's state and by its targets."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.face.devices.arm_group import ArmGroup

_THERE = 2e-3  # rad, of the stroke
_TICK_S = 0.01
_MOVES = 1e-4  # rad, of the stroke
_BLOCKED_S = 0.5  # without motion of the set-point: an emergency stop, the workspace


class MotorBus:
    """The motors of one follower arm, by the names and in the units of its features.

    Args:
        arms: the follower's.
        send: its `send_action`.
    """

    def __init__(self, arms: ArmGroup, send: Callable[[Mapping[str, Any]], Mapping[str, float]]):
        self._arms, self._send = arms, send

    @property
    def motors(self) -> dict[str, int]:
        """The place of each motor's value in an action.

        Raises:
            ConfigError: the stack cannot drive this follower.
        """
        arms = self._arms
        if len(arms.sides) != 1 or not arms.sides[0].has_gripper:
            raise ConfigError(f"{arms.device}: LeRobot's RL stack drives one arm with a gripper; use yam_follower")
        if not (arms.scale != 1.0).any():
            raise ConfigError(f"{arms.device}: LeRobot's RL stack computes in degrees; set use_degrees: true")
        return {name: place for place, name in enumerate(arms.motors)}

    def sync_read(self, register: str) -> dict[str, float]:
        """Present_Position of each motor: degrees, the gripper 0 closed … 1 open.

        Raises:
            ActionError: another register, which these motors do not have.
            YamError: the arm is silent or has failed.
        """
        self._check(register, "Present_Position", "leave add_current_to_observation off")
        (state,) = self._arms.observe()
        values = self._arms.action(np.array(state.positions))
        return {key.removesuffix(".pos"): value for key, value in values.items()}

    def sync_write(self, register: str, values: Mapping[str, Any]) -> None:
        """Have the arm go to Goal_Position, and wait until its set-point is there, or something holds it back.

        LeRobot writes the way to its reset pose in 0.75 s and then nothing for seconds. An arm that is slower would
        hold halfway.

        Raises:
            ActionError: another register, or wrong motors or values; nothing was sent.
            YamError: the arm is silent or has failed.
        """
        self._check(register, "Goal_Position", "it is the only one that can be written")
        action = {f"{name}.pos": float(value) for name, value in values.items()}
        clock = self._arms.clock
        before, moved_s = self._arms.held(), clock.now()
        while clock.now() - moved_s < _BLOCKED_S:
            sent, now = self._arms.vector(self._send(action)), self._arms.held()
            if np.abs(sent - now).max() < _THERE:
                return
            if np.abs(now - before).max() > _MOVES:
                before, moved_s = now, clock.now()
            clock.sleep(_TICK_S)

    def _check(self, register: str, known: str, remedy: str) -> None:
        if register != known:
            raise ActionError(f"{self._arms.device}: its motors have {known}, but no {register}; {remedy}")
