"""A `Runner` for arms of another computer: a link process here, the control loop there."""

import logging
from collections.abc import Callable
from typing import Any

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.remote.client.host_rig import HostedDevice
from lerobot_robot_yam.session.arm_session import clear_away
from lerobot_robot_yam.session.runners import ProcessRunner

logger = logging.getLogger(__name__)


class RemoteRunner(ProcessRunner):
    """Drives a group of a host's arms.

    Args:
        device: the group, as the host describes it.
        arms, keys: the same arms as they are called here.
    """

    _program = "lerobot_robot_yam.remote.client.link_process"

    def __init__(self, device: HostedDevice, arms: list[ResolvedArm], keys: list[str]):
        super().__init__(arms, keys)
        self._device = device
        self._written: set[int] = set()

    def _job(self) -> dict[str, Any]:
        device = self._device
        return {
            **super()._job(),
            "host": str(device.host.address),
            "key": device.host.key,
            "group": device.group,
            "numbers": device.numbers,
            "host_keys": device.host_keys,
            "all_keys": device.all_keys,
            "search": all(arm.config.gripper_search for arm in self._arms),
        }

    def note_written(self, arm: int) -> None:
        """Nudge the link process once all arms have something new, or one has so again: a caller writes to both right
        after each other. What it was not nudged for it passes on with the next state.
        """
        again = arm in self._written
        self._written.add(arm)
        if len(self._written) == len(self._arms):
            self._written.clear()
        elif not again:
            return
        if self._lifeline is not None:
            self._lifeline.nudge()

    def stop(self, off: Callable[[], bool] = lambda: True) -> bool:
        """Have the host land them; True when it says that they are down."""
        link = self._child
        ended = super().stop(off)
        if ended and link is not None and link.returncode < 0:
            logger.error("the link process was killed; the host lands the arms once it has missed it for long enough")
            for arm, key in zip(self._arms, self._keys, strict=True):
                clear_away(arm.config, key)
        return ended and off()
