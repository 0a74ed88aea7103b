"""Where a host is, and what of this computer a client tells it."""

import getpass
import importlib.metadata
import os
import socket
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.records import channel_key
from lerobot_robot_yam.system.runtime_files import runtime_dir

PORT = 5570  # of commands; states have the next one
INTERFACE = "remote"  # of an arm on a host, in place of python-can's
_OF_THE_HOST = ("calibration_path", "identity_path", "tuning")  # options of an arm that are files there
_PORT_MOST = 65534
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")  # drawn at each start; /etc/machine-id is copied with an image


@dataclass(frozen=True)
class HostAddress:
    """A computer and the first of its two ports.

    Attributes:
        host: name or IPv4 address.
        port: of commands; states have the next one.
    """

    host: str
    port: int = PORT

    @classmethod
    def of(cls, text: str) -> "HostAddress":
        """What `192.168.1.20` or `192.168.1.20:5570` says. Raises ConfigError: it is neither."""
        host, colon, port = text.rpartition(":") if ":" in text else (text, "", "")
        number = int(port) if port.isascii() and port.isdecimal() and len(port) < 6 else -1 if colon else PORT
        if not host or not host.isascii() or not all(c.isalnum() or c in ".-" for c in host):
            raise ConfigError(f"host {text!r}: write NAME or ADDRESS, or with a port, such as 192.168.1.20:{PORT}")
        if not 0 < number <= _PORT_MOST:
            raise ConfigError(f"host {text!r}: a port is a number from 1 to {_PORT_MOST}")
        return cls(host, number)

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    @property
    def commands(self) -> str:
        """Endpoint of commands."""
        return f"tcp://{self.host}:{self.port}"

    @property
    def states(self) -> str:
        """Endpoint of states."""
        return f"tcp://{self.host}:{self.port + 1}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer reaches it."""
        try:
            return ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def channel(self, channel: str) -> str:
        """What a channel of that computer is called on this one, such as `192.168.1.20:5570/can_follower_l`."""
        return f"{self}/{channel}"

    def key(self, channel: str) -> str:
        """Key under which this computer's programs find the state of the arm on that channel."""
        return channel_key(INTERFACE, self.channel(channel), None)

    def options(self, there: Mapping[str, Any]) -> dict[str, Any]:
        """Options of an arm of that computer with this one's name of its channel, and without the host's files."""
        here = {**there, "interface": INTERFACE, "channel": self.channel(there["channel"]), "can_options": {}}
        here |= dict.fromkeys(name for name in _OF_THE_HOST if name in there)
        if there.get("follower") is not None:
            here["follower"] = self.channel(there["follower"])
        return here


def who() -> str:
    """User, computer and process, for refusals of others."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user without a name, in a container
        user = str(os.getuid())
    return f"{user}@{socket.gethostname()} (process {os.getpid()})"


def package_version() -> str:
    """Of this package; empty where it runs from a checkout that is not installed."""
    try:
        return importlib.metadata.version("lerobot_robot_yam")
    except importlib.metadata.PackageNotFoundError:
        return ""


def machine_number() -> int:
    """By which the host knows this computer, user and runtime directory, which share one emergency stop.

    Computers of one image have the same name and the same users. Containers have the kernel of their computer.

    Raises:
        ConfigError: this computer cannot be told from others.
    """
    try:
        boot = _BOOT_ID.read_text().strip()
    except OSError as error:
        raise ConfigError(f"{_BOOT_ID}: {error.strerror}; is /proc mounted?") from error
    own = f"{boot} {socket.gethostname()} {os.getuid()} {runtime_dir()}"
    return zlib.crc32(own.encode()) + 1
