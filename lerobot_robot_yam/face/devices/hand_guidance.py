"""Followers that a hand moves: between the teleoperator `yam_hand_guide` and the follower of the same process.

LeRobot connects both, asks the teleoperator for an action and gives it to the follower. Here the action is where the
hand has led the follower: from the first action on its arms float, and only their grippers obey. Any other action, as
of a policy, ends that: the arms hold, and follow it. Without any action they hold after `command_timeout_s`.
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

_announced: "list[HandGuidance]" = []  # by connected teleoperators of this process


class HandGuidance:
    """Guidance of one follower by one teleoperator.

    Args:
        device: LeRobot's type name, for messages.
        keys: its action's.
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
        """The teleoperator is connected: the next follower of this process is for it.

        Raises:
            ConfigError: another one is connected already.
        """
        if _announced and self not in _announced:
            raise ConfigError(f"{self._device}: this process has a {_announced[0]._device} already")
        if self not in _announced:
            _announced.append(self)

    def withdraw(self) -> None:
        """The teleoperator has gone: the arms hold. Idempotent."""
        self.end()
        if self in _announced:
            _announced.remove(self)

    def attach(self, follower: str, arms: ArmGroup, space: "ArmGroup | EeSpace") -> None:
        """Be the guide of a follower that is about to be energised.

        Raises:
            ConfigError: it is not the one that the teleoperator speaks of, or that one guides another one.
        """
        if self._arms is not None and self._arms is not arms and self._arms.connected:
            raise ConfigError(f"{self._device}: guides {self._follower} already; disconnect that first")
        if differing := sorted(set(self._keys) ^ set(space.keys)):
            raise ConfigError(
                f"{self._device} and {follower}: only one has {', '.join(differing)}; give {self._device} the arm, "
                "gripper and action_space of the follower; bi_yam_hand_guide is for two arms"
            )
        self._follower, self._arms, self._space = follower, arms, space
        self._guides, self._given = False, {}

    def detach(self, arms: ArmGroup) -> None:
        """A follower goes. Idempotent."""
        if self._arms is arms:
            self._arms, self._guides = None, False

    def action(self, openings: Sequence[float | None]) -> dict[str, float]:
        """Where the hand has led the arms, which float from the first call on.

        Args:
            openings: of each arm's gripper, what it shall do, 0 closed … 1 open; None: it keeps its set-point.

        Raises:
            LifeCycleError: there is no follower yet, or an arm would run away.
            YamError: an arm is silent or has failed.
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
        """Set-point of the gripper of an arm by number, 0 closed … 1 open; open where there is none."""
        asked = None if self._arms is None else self._arms.newest()[arm].gripper_setpoint
        return 1.0 if asked is None else asked

    def _float(self, arms: ArmGroup) -> None:
        """Have all arms float. One that has held meanwhile, and is pulled at, goes on holding until it is let go."""
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
                    self.end()  # none of a pair floats alone
                    raise
                waits = str(error)
        if first:
            logger.info("%s: floats, and is guided by hand", self._follower)
        if waits and not self._waits:
            logger.warning("%s; let go of it for a moment", waits)
        self._waits = bool(waits)

    def take(self, action: Mapping[str, Any]) -> np.ndarray | None:
        """Pass the last action on, which moves nothing but grippers, and lets the arms float on.

        Returns:
            The joints and grippers (n,) that it stands for; None if it is another action: the arms hold then.
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
        """The arms hold where they are. Idempotent."""
        arms, guided = self._arms, self._guides
        self._guides = False
        if arms is None or not guided:
            return
        logger.info("%s: holds, and is no longer guided by hand", self._follower)
        for side in arms.sides:
            with contextlib.suppress(YamError):  # one that has failed or lands says so elsewhere
                if arms[side].mode() is Mode.FLOAT:
                    arms[side].hold()


def guidance() -> HandGuidance | None:
    """That of this process, if a hand-guide teleoperator is connected."""
    return _announced[0] if _announced else None
