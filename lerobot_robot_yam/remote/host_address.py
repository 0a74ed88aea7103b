"""Address of a host, and names that clients send to the host."""

import getpass
import importlib.metadata
import os
import re
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

PORT = 5570  # default port of commands; states use the next port
INTERFACE = "remote"  # interface name of an arm on a host, in place of a python-can interface
_OF_THE_HOST = ("calibration_path", "identity_path", "tuning")  # arm options that name files on the host
_PORT_MOST = 65534
_ADDRESS = re.compile(r"([A-Za-z0-9][A-Za-z0-9.-]*)(?::([0-9]{1,5}))?")
# id of the current boot, not /etc/machine-id, which copies of a disk share
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True)
class HostAddress:
    """Host and its first port.

    Attributes:
        host: name or IPv4 address.
        port: port of commands; states use the next port.
    """

    host: str
    port: int = PORT

    @classmethod
    def of(cls, text: str) -> "HostAddress":
        """Parse `192.168.1.20` or `192.168.1.20:5570`. Raises ConfigError: `text` has neither form."""
        found = _ADDRESS.fullmatch(text)
        if found is None or not 0 < (port := int(found[2] or PORT)) <= _PORT_MOST:
            raise ConfigError(
                f"host {text!r}: write NAME or ADDRESS, or with a port up to {_PORT_MOST}, such as 192.168.1.20:{PORT}"
            )
        return cls(found[1], port)

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    @property
    def commands(self) -> str:
        """ZeroMQ endpoint of commands."""
        return f"tcp://{self.host}:{self.port}"

    @property
    def states(self) -> str:
        """ZeroMQ endpoint of states."""
        return f"tcp://{self.host}:{self.port + 1}"

    @property
    def is_loopback(self) -> bool:
        """Whether the address can be reached from this computer only."""
        try:
            return ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def channel(self, channel: str) -> str:
        """Return this computer's name for a channel of the host, such as `192.168.1.20:5570/can_follower_l`."""
        return f"{self}/{channel}"

    def key(self, channel: str) -> str:
        """Return this computer's key for the state of the arm on a channel of the host."""
        return channel_key(INTERFACE, self.channel(channel), None)

    def options(self, there: Mapping[str, Any]) -> dict[str, Any]:
        """Translate a part's options from the host: channels get this computer's names, file options become None."""
        here = {**there, "interface": INTERFACE, "channel": self.channel(there["channel"]), "can_options": {}}
        here |= dict.fromkeys(name for name in _OF_THE_HOST if name in there)
        if there.get("rail") is not None:
            here["rail"] = {**there["rail"], "calibration_path": None}
        if there.get("follower") is not None:
            here["follower"] = self.channel(there["follower"])
        return here


def who() -> str:
    """Return user, computer and process as text, for messages to other clients."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user without a name, in a container
        user = str(os.getuid())
    return f"{user}@{socket.gethostname()} (process {os.getpid()})"


def package_version() -> str:
    """Return the version of this package; empty when running from a checkout that is not installed."""
    try:
        return importlib.metadata.version("lerobot_robot_yam")
    except importlib.metadata.PackageNotFoundError:
        return ""


def machine_name() -> str:
    """Return an id of this runtime directory, whose users share one emergency stop: 8 hex digits.

    The boot id distinguishes computers that were set up from the same disk image. Containers share the boot id of their
    computer, and may share its name, users and paths; but each directory has its own numbers in the running kernel.

    Raises:
        ConfigError: /proc is missing, so this computer cannot be distinguished from others.
    """
    try:
        boot = _BOOT_ID.read_text().strip()
    except OSError as error:
        raise ConfigError(f"{_BOOT_ID}: {error.strerror}; is /proc mounted?") from error
    directory = os.stat(runtime_dir())
    own = f"{boot} {directory.st_dev} {directory.st_ino}"
    return f"{zlib.crc32(own.encode()):08x}"
