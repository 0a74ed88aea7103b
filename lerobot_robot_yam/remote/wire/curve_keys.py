"""Keys of host and clients (CURVE, Curve25519), in files that only their user can read.

The host has one pair, and a file with the public key of each client that may use it. A client has one file: its pair,
and the host's public key. `yam-host pair` makes both. The file of the host's pair is that of a client, too, for
`yam-host status`.
"""

import json
import os
import re
import stat
from dataclasses import asdict, dataclass
from pathlib import Path

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

_HOST, _CLIENTS = "host.json", "clients"
_KEY = re.compile(rb"[0-9A-Za-z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")  # Z85, rfc.zeromq.org/spec/32
_NAME = re.compile(r"[A-Za-z0-9_-]{1,60}")
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


@dataclass(frozen=True)
class ClientKey:
    """What a client has: its pair, and the host's public key. 40 characters each."""

    public: bytes
    secret: bytes
    host: bytes

    @classmethod
    def load(cls, path: str | Path) -> "ClientKey":
        """From its file. Raises ConfigError: it cannot be read, others can read it, or it is none."""
        return cls(**_read(user_path(path), ("public", "secret", "host")))


@dataclass(frozen=True)
class HostKeys:
    """What a host has: its pair, its file, and a directory of clients' public keys, as pyzmq's authenticator wants."""

    public: bytes
    secret: bytes
    file: Path
    clients: Path

    @classmethod
    def load(cls, directory: Path) -> "HostKeys | None":
        """From its directory; None: no client was paired yet. Raises ConfigError: see `ClientKey.load`."""
        if not (directory / _HOST).exists() or not any((directory / _CLIENTS).glob("*.key")):
            return None
        file = directory / _HOST
        return cls(**_read(file, ("public", "secret")), file=file, clients=directory / _CLIENTS)


def keys_directory() -> Path:
    """Where a host keeps its keys: `yam/host-keys` in the user's configuration directory."""
    return user_path(os.environ.get("XDG_CONFIG_HOME") or "~/.config") / "yam" / "host-keys"


def pair(directory: Path, name: str, target: Path) -> None:
    """Make keys for a client, and the host's own at the first time.

    Args:
        directory: of the host's keys.
        name: of the client.
        target: the client's file, to be carried to its computer.

    Raises:
        ConfigError: the name is none or taken, there is such a file, or it cannot be written.
    """
    import zmq

    if not _NAME.fullmatch(name):
        raise ConfigError(f"name {name!r}: letters, digits, - and _, at most 60")
    client = directory / _CLIENTS / f"{name}.key"
    if client.exists():
        raise ConfigError(f"{name} is paired already; remove {client} to have it forgotten, or choose another name")
    if target.exists():
        raise ConfigError(f"there is {target} already")
    try:
        (directory / _CLIENTS).mkdir(mode=0o700, parents=True, exist_ok=True)
        if not (directory / _HOST).exists():
            public, secret = zmq.curve_keypair()
            _write(directory / _HOST, ClientKey(public, secret, host=public))
        host = _read(directory / _HOST, ("public", "secret"))
        public, secret = zmq.curve_keypair()
        _write(target, ClientKey(public, secret, host["public"]))
        client.write_text(f'metadata\ncurve\n    public-key = "{public.decode()}"\n')
    except OSError as error:
        raise ConfigError(f"the keys cannot be written: {error}") from error


def paired(directory: Path) -> list[str]:
    """Names of the clients that are paired."""
    return sorted(path.stem for path in (directory / _CLIENTS).glob("*.key"))


def _write(path: Path, key: ClientKey) -> None:
    fields = {field: value.decode() for field, value in asdict(key).items()}
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(json.dumps(fields, indent=1) + "\n")


def _read(path: Path, names: tuple[str, ...]) -> dict[str, bytes]:
    try:
        mode = path.stat().st_mode
        found = json.loads(path.read_text())
        keys = {name: str(found[name]).encode() for name in names}
    except OSError as error:
        raise ConfigError(f"key {path}: {error.strerror}; `yam-host pair` on the arms' computer makes it") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ConfigError(f"{path} is no key of `yam-host pair` ({error!r})") from error
    if mode & _OTHERS:
        raise ConfigError(f"{path} can be read by others, who could drive the arms with it: chmod 600 {path}")
    if not all(_KEY.fullmatch(key) for key in keys.values()):
        raise ConfigError(f"{path} is no key of `yam-host pair`")
    return keys
