"""Group of a host's arms as a LeRobot device on this computer: options of the device, and its `Runner`.

The runner starts a link process on this computer; the control loop runs on the host.
"""

import logging
from collections.abc import Callable
from functools import partial
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.robot_parts import Part
from lerobot_robot_yam.remote.host_question import Host, hello
from lerobot_robot_yam.session.arm_session import MakeRunner, clear_away
from lerobot_robot_yam.session.runners import ProcessRunner

logger = logging.getLogger(__name__)

# LeRobot's type of a device at its own computer → type at another computer
_TYPES = {
    "yam_follower": "yam_remote",
    "bi_yam_follower": "bi_yam_remote",
    "yam_base": "yam_base_remote",
    "yam_mobile": "yam_mobile_remote",
    "yam_leader": "yam_remote_leader",
    "bi_yam_leader": "bi_yam_remote_leader",
}


class HostedDevice:
    """Robot or teleoperator of a host.

    Attributes:
        host: the host.
        group: "robot" or "teleop".
        options: prefix → options of an arm or of the base, as for LeRobot's local device, with this computer's names
            of the channels.
        numbers: number of each of these parts on the host.
        all_keys: for every part of the host: channel key on the host → channel key on this computer.
        calibrated: whether the host knows the stops of all grippers.

    Raises:
        LinkError: the host does not reply.
        ConfigError: the host has no such group, or the group has other parts.
    """

    def __init__(self, host: Host, group: str, prefixes: tuple[str, ...]):
        self.host, self.group = host, group
        address, groups = host.address, hello(host)["groups"]
        if group not in groups:
            raise ConfigError(f"the rig of {address} has no {group}; it has {', '.join(groups) or 'no arms'}")
        parts: dict[str, Any] = groups[group]["parts"]
        if tuple(parts) != prefixes:
            there = groups[group]["device"]
            raise ConfigError(f"the {group} of {address} is a {there}; its type here is {_TYPES.get(there, there)}")
        self.options = {prefix: address.options(part["options"]) for prefix, part in parts.items()}
        self.numbers = [int(part["number"]) for part in parts.values()]
        self.all_keys = keys_of(host, groups)
        self.calibrated = bool(groups[group]["calibrated"])

    def runner(self) -> MakeRunner:
        """Return the function that creates the `Runner` of a session with these arms."""
        return partial(RemoteRunner, self)


def keys_of(host: Host, groups: dict[str, Any]) -> dict[str, str]:
    """Map channel keys on the host to channel keys on this computer, for all arms in the host's reply to a hello."""
    every = [part for group in groups.values() for part in group["parts"].values()]
    return {part["key"]: host.address.key(part["options"]["channel"]) for part in every}


class RemoteRunner(ProcessRunner):
    """Runner of a group of a host's arms.

    Args:
        device: the group, as the host describes it.
        parts, keys: the group's parts and channel keys, with this computer's names.
    """

    _program = "lerobot_robot_yam.remote.link_process"

    def __init__(self, device: HostedDevice, parts: list[Part], keys: list[str]):
        super().__init__(parts, keys)
        self._device = device
        configs = [part.config for part in parts]
        self._search = all(config.gripper_search for config in configs if isinstance(config, ArmConfig))

    def _job(self) -> dict[str, Any]:
        device = self._device
        return {
            **super()._job(),
            "host": str(device.host.address),
            "key": device.host.key,
            "group": device.group,
            "numbers": device.numbers,
            "all_keys": device.all_keys,
            "search": self._search,
        }

    def note_written(self, arm: int) -> None:
        """Wake the link process, so that it sends the command at once instead of with the next state."""
        if self._lifeline is not None:
            self._lifeline.nudge()

    def stop(self, off: Callable[[], bool] = lambda: True) -> bool:
        """Land the arms on the host. Return whether they have landed."""
        link = self._child
        ended = super().stop(off)
        if ended and link is not None and link.returncode < 0:
            logger.error("the link process was killed; the host lands the arms once it has missed it for long enough")
            for arm, key in zip(self._arms, self._keys, strict=True):
                clear_away(arm.config, key)
        return ended and off()
