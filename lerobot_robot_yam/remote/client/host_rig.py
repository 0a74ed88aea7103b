"""A group of a host's arms as LeRobot's device on this computer sees it: what the host tells of it, in our words."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from lerobot_robot_yam.errors import ConfigError, LinkError
from lerobot_robot_yam.remote.client.host_question import Host, hello
from lerobot_robot_yam.remote.wire.host_address import INTERFACE, HostAddress

_OF_THE_HOST = ("calibration_path", "identity_path", "tuning")  # its files


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
        self.options = {prefix: ours(address, arm["options"]) for prefix, arm in arms.items()}
        self.numbers = [int(arm["number"]) for arm in arms.values()]
        self.host_keys = [str(arm["key"]) for arm in arms.values()]
        every = [arm for group in groups.values() for arm in group["arms"].values()]
        self.all_keys = {str(arm["key"]): address.key(arm["options"]["channel"]) for arm in every}
        self.calibrated = bool(found["calibrated"])

    def runner(self) -> Any:
        """What makes the `Runner` of a session with these arms."""
        from lerobot_robot_yam.remote.client.remote_runner import RemoteRunner

        return partial(RemoteRunner, self)


def ours(address: HostAddress, options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of an arm with this computer's name of its channel, and without the host's files."""
    found = {**options, "interface": INTERFACE, "channel": address.channel(options["channel"]), "can_options": {}}
    found |= dict.fromkeys(name for name in _OF_THE_HOST if name in options)
    if options.get("follower") is not None:
        found["follower"] = address.channel(options["follower"])
    return found
