"""A group of a host's arms as LeRobot's device on this computer has it: what the host tells of it, and its `Runner`.

The runner starts a link process here; the control loop is there.
"""

import logging
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError, LinkError
from lerobot_robot_yam.remote.client.host_question import Host, hello
from lerobot_robot_yam.session.arm_session import MakeRunner, clear_away
from lerobot_robot_yam.session.runners import ProcessRunner

logger = logging.getLogger(__name__)


class HostedDevice:
    """The robot or the teleoperator of a host.

    Attributes:
        host: where it is.
        group: "robot" or "teleop".
        options: of each arm by prefix, as LeRobot's local device has them, with this computer's names of channels.
        numbers, host_keys: of each arm, on the host.
        all_keys: of every arm of the host, its key there and here.
        calibrated: the stops of all grippers are known to the host.

    Raises:
        LinkError: the host does not answer.
        ConfigError: it has no such group, or one with another number of arms.
    """

    def __init__(self, host: Host, group: str, prefixes: tuple[str, ...]):
        self.host, self.group = host, group
        told = hello(host)
        try:
            self._read(told, prefixes)
        except (KeyError, TypeError, AttributeError) as error:
            raise LinkError(f"{host.address}: its hello makes no sense: {error!r}") from error

    def _read(self, told: Mapping[str, Any], prefixes: tuple[str, ...]) -> None:
        address, groups = self.host.address, told["groups"]
        if self.group not in groups:
            raise ConfigError(f"the rig of {address} has no {self.group}; it has {', '.join(groups) or 'no arms'}")
        found = groups[self.group]
        arms: dict[str, Any] = found["arms"]
        if tuple(arms) != prefixes:
            kind = "bi_yam_remote" if len(arms) == 2 else "yam_remote"
            raise ConfigError(
                f"the {self.group} of {address} has {len(arms)} arm{'s' * (len(arms) != 1)}; its type here is "
                f"{kind if self.group == 'robot' else f'{kind}_leader'}"
            )
        self.options = {prefix: address.options(arm["options"]) for prefix, arm in arms.items()}
        self.numbers = [int(arm["number"]) for arm in arms.values()]
        self.host_keys = [str(arm["key"]) for arm in arms.values()]
        every = [arm for group in groups.values() for arm in group["arms"].values()]
        self.all_keys = {str(arm["key"]): address.key(arm["options"]["channel"]) for arm in every}
        self.calibrated = bool(found["calibrated"])

    def runner(self) -> MakeRunner:
        """What makes the `Runner` of a session with these arms."""
        return partial(RemoteRunner, self)


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
