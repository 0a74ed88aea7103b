"""Devices that another computer drives: their options, and the calls that need files of that computer.

LeRobot loads this module at its start, so slow imports are delayed.
"""

import dataclasses
from typing import TYPE_CHECKING, Any

from lerobot.utils.decorators import check_if_not_connected

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.mobile.base_config import BASE_PREFIX, BaseConfig

if TYPE_CHECKING:
    from lerobot_robot_yam.remote.hosted_device import HostedDevice
    from lerobot_robot_yam.session.arm_session import Isolation


@dataclasses.dataclass(kw_only=True)
class RemoteOptions:
    """Options that identify the computer with the arms."""

    host: str = option("the computer that has the arms, where yam-host runs: NAME or ADDRESS, or with :PORT")
    key: str | None = option(
        "this computer's key file, which `yam-host pair` makes there; by default none, which only a host on this "
        "computer or behind an ssh tunnel takes",
        None,
    )

    def ask_host(self, group: str, prefixes: tuple[str, ...]) -> None:
        """Request the description of the arms from the host: LeRobot needs the action's keys before it connects.

        Raises:
            RefusedConfigError: the host does not reply, or has other arms.
        """
        from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError
        from lerobot_robot_yam.remote.host_address import HostAddress
        from lerobot_robot_yam.remote.host_question import Host
        from lerobot_robot_yam.remote.hosted_device import HostedDevice

        try:
            if getattr(self, "isolation", "process") != "process":
                raise ConfigError("isolation: the control loop runs on the host, always in a process of its own")
            self._hosted = HostedDevice(Host(HostAddress.of(self.host), self.key), group, prefixes)
        except YamError as error:
            raise RefusedConfigError(str(error)) from error

    def base(self) -> BaseConfig | None:
        """Return the config of the host's base, if it has one."""
        options = self.hosted.options.get(BASE_PREFIX)
        return None if options is None else BaseConfig(**options)

    @property
    def hosted(self) -> "HostedDevice":
        """The host's description of the device."""
        return self._hosted

    def runs(self) -> "Isolation":
        """Return the isolation that runs the control loop on the host."""
        return self._hosted.runner()


class RemoteDevice:
    """Mixin for LeRobot's `Robot` and `Teleoperator`."""

    config: Any

    @property
    def is_calibrated(self) -> bool:
        """Whether the host had files with the stops of all gripper motors, and of its rail, when it was asked."""
        return bool(self.config.hosted.calibrated)

    @check_if_not_connected
    def calibrate(self) -> None:
        """Raise ConfigError: only the host has the calibration files."""
        raise ConfigError(
            "calibrate it on its own computer: end yam-host there, then run lerobot-calibrate with the rig's file"
        )
