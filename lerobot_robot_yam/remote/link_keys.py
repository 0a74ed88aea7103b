"""Keys of host and clients (CURVE, Curve25519), in files that only their owner can read.

A host has its own key, and a folder with the public key of each permitted client, in the format of pyzmq's
authenticator. A client has one file: its key pair, and the host's public key. `yam-host pair` creates all files.
"""

import os
import re
import stat
from pathlib import Path
from typing import Annotated

import msgspec
import zmq
from msgspec import Meta

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

HOST_KEY, CLIENTS = "host.json", "clients"  # names of the host's key file and of the folder with its clients' keys
_NAME = re.compile(r"[A-Za-z0-9_-]{1,60}")
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_Z85 = Annotated[str, Meta(pattern=r"^[0-9A-Za-z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}\Z")]  # rfc.zeromq.org/spec/32


class LinkKey(msgspec.Struct, frozen=True):
    """Key pair, and the host's public key. The host's own `LinkKey` lets `yam-host status` act as a client."""

    public: _Z85
    secret: _Z85
    host: _Z85

    @classmethod
    def load(cls, path: str | Path) -> "LinkKey":
        """Read a key file. Raises ConfigError: the file is unreadable, readable by other users, or contains no key."""
        path = user_path(path)
        try:
            mode = path.stat().st_mode
            key = msgspec.json.decode(path.read_bytes(), type=cls)
        except OSError as error:
            raise ConfigError(
                f"key {path}: {error.strerror}; `yam-host pair` on the arms' computer makes it"
            ) from error
        except (ValueError, RecursionError) as error:
            raise ConfigError(
                f"{path} is no key of `yam-host pair` ({error}); make one with it on the arms' computer"
            ) from error
        if mode & _OTHERS:
            raise ConfigError(f"{path} can be read by others, who could drive the arms with it: chmod 600 {path}")
        return key

    def _write(self, path: Path) -> None:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(msgspec.json.format(msgspec.json.encode(self), indent=1) + b"\n")


def keys_directory() -> Path:
    """Return the directory of a host's keys: `yam/host-keys` in the user's configuration directory."""
    return user_path(os.environ.get("XDG_CONFIG_HOME") or "~/.config") / "yam" / "host-keys"


def paired(directory: Path) -> list[str]:
    """Return the names of the paired clients."""
    return sorted(path.stem for path in (directory / CLIENTS).glob("*.key"))


def pair(directory: Path, name: str, target: Path) -> None:
    """Create a key for a client and, the first time, the host's own key.

    Args:
        directory: directory of the host's keys.
        name: the client's name.
        target: key file to write for the client; a person has to copy it to the client's computer.

    Raises:
        ConfigError: the name is invalid or in use, the file exists already, or a file cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(f"name {name!r}: letters, digits, - and _, at most 60")
    client, own = directory / CLIENTS / f"{name}.key", directory / HOST_KEY
    if client.exists():
        raise ConfigError(f"{name} is paired already; remove {client} to have it forgotten, or choose another name")
    if target.exists():
        raise ConfigError(f"there is {target} already")
    try:
        client.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not own.exists():
            public, secret = _keypair()
            LinkKey(public, secret, host=public)._write(own)
        public, secret = _keypair()
        LinkKey(public, secret, LinkKey.load(own).public)._write(target)
        client.write_text(f'metadata\ncurve\n    public-key = "{public}"\n')
    except OSError as error:
        raise ConfigError(f"the keys cannot be written: {error}") from error


def _keypair() -> tuple[str, str]:
    public, secret = zmq.curve_keypair()
    return public.decode(), secret.decode()
