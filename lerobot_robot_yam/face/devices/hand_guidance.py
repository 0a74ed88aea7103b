"""Followers guided by hand, with the teleoperator `yam_hand_guide` in the same process.

LeRobot connects follower and teleoperator, reads the teleoperator's action and sends it to the follower. The action is
the pose to which a person has moved the follower: from the first action on the arms float, and only grippers follow the
action. Any other action, such as a policy's, ends the guidance: the arms hold, and then follow that action. Without any
action the arms hold after `command_timeout_s`.
"""

import contextlib
import logging
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError, LifeCycleError, YamError
from lerobot_robot_yam.face.devices.arm_group import ArmGroup
from lerobot_robot_yam.state.modes import Mode

if TYPE_CHECKING:
    from lerobot_robot_yam.face.devices.ee_space import EeSpace

logger = logging.getLogger(__name__)

_announced: "HandGuidance | None" = None  # guidance of this process's connected teleoperator


class HandGuidance:
    """Guidance of one follower by one teleoperator.

    device: LeRobot's type name, for messages. keys: the teleoperator's action keys.
    """

    def __init__(self, device: str, keys: Sequence[str]):
        self._device, self._keys = device, list(keys)
        self._arms: ArmGroup | None = None
        self._space: ArmGroup | EeSpace | None = None
        self._follower = ""
        self._given: dict[str, float] = {}
        self._target: np.ndarray = np.zeros(0)
        self._guides = self._waits = False

    def announce(self) -> None:
        """Offer the connected teleoperator to the next follower of this process.

        Raises:
            ConfigError: another teleoperator of this kind is already connected.
        """
        global _announced
        if _announced is not None and _announced is not self:
            raise ConfigError(f"{self._device}: this process has a {_announced._device} already")
        _announced = self

    def withdraw(self) -> None:
        """Disconnect the teleoperator; the arms hold. Idempotent."""
        global _announced
        self.end()
        if _announced is self:
            _announced = None

    def attach(self, follower: str, arms: ArmGroup, space: "ArmGroup | EeSpace", keys: Sequence[str]) -> None:
        """Guide a follower that is about to be energised. keys: the follower's action keys.

        Raises:
            ConfigError: follower and teleoperator have different action keys, or another follower is already guided.
        """
        if self._arms is not None and self._arms is not arms and self._arms.connected:
            raise ConfigError(f"{self._device}: guides {self._follower} already; disconnect that first")
        if differing := sorted(set(self._keys) ^ set(keys)):
            raise ConfigError(
                f"{self._device} and {follower}: only one has {', '.join(differing)}; give {self._device} the arm, "
                "gripper and action_space of the follower; bi_yam_hand_guide is for two arms"
            )
        self._follower, self._arms, self._space = follower, arms, space
        self._guides, self._given = False, {}

    def detach(self, arms: ArmGroup) -> None:
        """Release a follower that disconnects. Idempotent."""
        if self._arms is arms:
            self._arms, self._guides = None, False

    def action(self, openings: Sequence[float | None]) -> dict[str, float]:
        """Return the pose to which a person has moved the arms. The arms float from the first call on.

        Args:
            openings: target of each arm's gripper, 0 closed … 1 open; None keeps its set-point.

        Raises:
            LifeCycleError: there is no follower yet, or an arm would move away by itself.
            YamError: an arm is silent or in fault.
        """
        arms = self._arms
        if arms is None or self._space is None:
            raise LifeCycleError(f"{self._device} guides a follower of its own process; connect that first")
        if not self._guides or any(state.mode in (Mode.HOLD, Mode.TRACK) for state in arms.newest()):
            self._float(arms)
        values: list[float] = []
        for side, state, opening in zip(arms.sides, arms.observe(), openings, strict=True):
            hardware = side.hardware
            joints = np.minimum(np.maximum(state.q, hardware.lower[: side.joints]), hardware.upper[: side.joints])
            values += joints.tolist()
            if side.has_gripper:
                asked = state.gripper_setpoint if opening is None else opening
                assert asked is not None
                values.append(asked)
        self._target = np.array(values)
        self._given = self._space.action(self._target)
        return dict(self._given)

    def opening(self, arm: int) -> float:
        """Return the gripper set-point of an arm (by number), 0 closed … 1 open; 1 without a follower."""
        asked = None if self._arms is None else self._arms.newest()[arm].gripper_setpoint
        return 1.0 if asked is None else asked

    def _float(self, arms: ArmGroup) -> None:
        """Let all arms float. An arm that holds again while a person pulls at it floats once the person releases it."""
        first, self._guides = not self._guides, True
        waits = ""
        for side, state in zip(arms.sides, arms.newest(), strict=True):
            if state.mode not in (Mode.HOLD, Mode.TRACK):
                continue
            try:
                if first:
                    arms[side].guide()
                else:
                    arms[side].guide(within_s=0.0)
            except YamError as error:
                if first or not isinstance(error, LifeCycleError):
                    self.end()  # no arm of a pair floats alone
                    raise
                waits = str(error)
        if first:
            logger.info("%s: floats, and is guided by hand", self._follower)
        if waits and not self._waits:
            logger.warning("%s; let go of it for a moment", waits)
        self._waits = bool(waits)

    def take(self, action: Mapping[str, Any]) -> np.ndarray | None:
        """Apply an action if it is the teleoperator's last one: only grippers move, and the arms keep floating.

        Returns:
            The action's joints and grippers (n,); None for any other action, after which the arms hold.
        """
        given, arms = self._given, self._arms
        if arms is None or not self._guides:
            return None
        if given.keys() != action.keys() or not all(np.array_equal(action[key], given[key]) for key in given):
            self.end()
            return None
        for side, state in zip(arms.sides, arms.newest(), strict=True):
            if state.mode is Mode.FLOAT:
                index = side.gripper_index
                arms[side].guide_on(None if index is None else float(self._target[index]))
        return self._target.copy()

    def end(self) -> None:
        """End the guidance; the arms hold their poses. Idempotent."""
        arms, guided = self._arms, self._guides
        self._guides = False
        if arms is None or not guided:
            return
        logger.info("%s: holds, and is no longer guided by hand", self._follower)
        for side in arms.sides:
            with contextlib.suppress(YamError):  # a failed or landing arm is reported elsewhere
                if arms[side].mode() is Mode.FLOAT:
                    arms[side].hold()


def guidance() -> HandGuidance | None:
    """Return the guidance of this process's connected hand-guide teleoperator, if any."""
    return _announced
