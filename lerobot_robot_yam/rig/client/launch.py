"""Find or start a virtual rig: one server process per rig name, started under a lock.

The server is a child of init, because it must outlive the process that started it. The server ends after its last
client has disconnected.
"""

import contextlib
import difflib
import json
import logging
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import BusError, ConfigError, RigError, YamError
from lerobot_robot_yam.rig.scene.scene import SCENES, Scene, load_scene
from lerobot_robot_yam.system.clock import START_TIMEOUT_S
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.runtime_files import FileLock, rig_name, runtime_dir, slug

logger = logging.getLogger(__name__)

_HELLO_TIMEOUT_S = 10.0
_PROBE_TIMEOUT_S = 0.2
_said: set[tuple[str, str]] = set()  # rigs and options whose lack of effect has been logged
# Names of files of rigs and of their arms' blocks, with the id of the process that created them.
_MADE_BY = re.compile(r"(?:rig|state)-((?:auto|rig|env)-(\d+)(?:-\d+)?)\.(?!lock$)")
MAX_PACKET = 1 << 17  # maximum packet size in either direction, bytes

# Program of a short-lived parent process, so that the server becomes a child of init, not a zombie of this process.
_DETACH = "import os, sys\nif os.fork(): os._exit(0)\nos.setsid()\nos.execv(sys.executable, sys.argv[1:])"


def to_json(message: Mapping[str, Any]) -> bytes:
    """Encode a message as one packet; numpy values become lists and numbers."""
    return json.dumps(message, default=_plain).encode()


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")


def rig_path(name: str, suffix: str) -> Path:
    """Return the path of a rig's file.

    suffix: "sock", "lock", "scene", "world", "links", "log" (while the rig runs) or "crash" (its last log).
    """
    return runtime_dir() / f"rig-{slug(name)}.{suffix}"


def connect(name: str, hello: Mapping[str, Any]) -> tuple[socket.socket, dict[str, Any]]:
    """Connect to a running rig and send a hello, see `server`.

    Returns:
        The socket (SEQPACKET, blocking) and the rig's reply.

    Raises:
        ConnectionRefusedError, FileNotFoundError: no rig with this name is running.
        BusError, ConfigError, RigError: the rig rejected the hello, for example because the channel is unknown.
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        sock.settimeout(_HELLO_TIMEOUT_S)
        sock.connect(str(rig_path(name, "sock")))
        sock.send(to_json(hello))
        answer = sock.recv(MAX_PACKET)
        if not answer:
            raise ConnectionRefusedError(f"rig {name} is ending")
        reply = checked(json.loads(answer))
        sock.settimeout(None)
        return sock, reply
    except BaseException as error:
        sock.close()
        if isinstance(error, BrokenPipeError | ConnectionResetError):
            raise ConnectionRefusedError(f"rig {name} is ending") from error
        if isinstance(error, TimeoutError):
            raise RigError(f"rig {name} does not answer; end it (its pid is in {rig_path(name, 'log')})") from error
        raise


def checked(answer: dict[str, Any]) -> dict[str, Any]:
    """Return a rig's reply, or raise the error that the reply contains."""
    if "error" in answer:
        kind = {"BusError": BusError, "ConfigError": ConfigError}.get(answer.get("kind", ""), RigError)
        raise kind(answer["error"])
    return answer


def error_reply(error: Exception) -> dict[str, Any]:
    """Encode an error as a reply from which `checked` raises it again."""
    kind = next((k.__name__ for k in (BusError, ConfigError) if isinstance(error, k)), "RigError")
    text = str(error) if isinstance(error, YamError) else f"malformed request: {type(error).__name__}: {error}"
    return {"error": text, "kind": kind}


def no_channel(rig: str, name: str, channels: Iterable[str]) -> str:
    """Return the error message for a channel that a rig does not have."""
    known = list(channels)
    near = difflib.get_close_matches(name, known, 1)
    meant = f"did you mean {near[0]!r}? It" if near else "it"
    return f"rig {rig} has no channel {name!r}; {meant} has {', '.join(known)}"


def connect_or_start(
    rig: str | None, hello: Mapping[str, Any], scene: str | None = None, options: Mapping[str, Any] | None = None
) -> tuple[socket.socket, str, dict[str, Any]]:
    """Connect to a rig; start the rig first if it is not running.

    Args:
        rig: name of the rig, see `runtime_files.rig_name`.
        hello: first message to the rig, see `server`.
        scene: scene name or path, used if this call starts the rig.
        options: scene options, used if this call starts the rig. A running rig keeps its own options; differences are
            logged.

    Returns:
        Socket, resolved rig name, reply of the rig.

    Raises:
        RigError: the rig cannot be started.
        BusError, ConfigError: the scene, an option or the channel is wrong.
    """
    name, owner = rig_name(rig)
    with contextlib.suppress(ConnectionRefusedError, FileNotFoundError):
        return _join(name, hello, scene, options or {})
    with FileLock(rig_path(name, "lock"), f"the start of rig {name}"):
        with contextlib.suppress(ConnectionRefusedError, FileNotFoundError):
            return _join(name, hello, scene, options or {})
        _sweep()
        _start(name, owner, scene, options or {})
        try:
            connection, answer = connect(name, hello)
            return connection, name, answer
        except (ConnectionRefusedError, FileNotFoundError) as error:
            raise RigError(f"rig {name} ended right after its start; see {rig_path(name, 'log')}") from error


def _join(
    name: str, hello: Mapping[str, Any], scene: str | None, options: Mapping[str, Any]
) -> tuple[socket.socket, str, dict[str, Any]]:
    """Connect to a running rig, and log the requested scene and options that the running rig ignores."""
    asked = {**({} if scene is None else {"scene": load_scene(scene).name}), **options}
    connection, answer = connect(name, hello)
    has = {"scene": answer["scene"], **answer["options"]}
    for key, value in asked.items():
        held = has.get(key)
        given = value.split(",") if isinstance(value, str) and isinstance(held, list) else value
        if json.loads(json.dumps(given)) != held and (name, key) not in _said:
            _said.add((name, key))  # once per process, although each arm and camera joins
            logger.warning("rig %s runs already, with %s: %r; %r has no effect", name, key, held, value)
    return connection, name, answer


def tell_scene(rig: str, scene: str | None, options: Mapping[str, Any]) -> None:
    """Write scene and options to a file beside the rig's socket, for processes that build the same world."""
    whole = scene if scene is None or scene in SCENES else str(user_path(scene).absolute())
    rig_path(rig, "scene").write_bytes(to_json({"scene": whole, "options": options}))


def told_scene(rig: str) -> Scene:
    """Read the scene of a running rig from the rig's file.

    Raises:
        RigError: no rig with this name is running, or it runs another version.
        ConfigError: the scene file has changed since the rig started.
    """
    try:
        told = json.loads(rig_path(rig, "scene").read_bytes())
        scene, options = told["scene"], told["options"]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise RigError(f"rig {rig} does not say what it simulates ({error}); start it anew") from error
    return load_scene(scene, options)


def _start(name: str, owner: int | None, scene: str | None, options: Mapping[str, Any]) -> None:
    """Start the server and wait until it listens. The caller must hold the rig's lock."""
    ready, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    server = [sys.executable, "-P", "-m", "lerobot_robot_yam.rig.server.server", "--name", name]
    server += ["--ready-fd", str(theirs.fileno()), "--options", to_json(options).decode()]
    server += ([] if scene is None else ["--scene", scene]) + ([] if owner is None else ["--owner", str(owner)])
    answer = b""
    with ready:
        with theirs, open(rig_path(name, "log"), "wb") as log:
            subprocess.run(
                [sys.executable, "-S", "-c", _DETACH, *server],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        ready.settimeout(START_TIMEOUT_S)
        with contextlib.suppress(TimeoutError):
            answer = ready.recv(MAX_PACKET)  # empty if the server has died
    if not answer:
        raise RigError(f"rig {name} did not come up; see {rig_path(name, 'log')}")
    reply = json.loads(answer)
    if "error" in reply:
        rig_path(name, "log").unlink(missing_ok=True)
    checked(reply)


def _sweep() -> None:
    """Remove the files of killed rigs whose starting processes have ended."""
    left: dict[str, list[Path]] = {}
    for path in runtime_dir().iterdir():
        made_by = _MADE_BY.match(path.name)
        if made_by is not None and not Path(f"/proc/{made_by[2]}").exists():
            left.setdefault(made_by[1], []).append(path)
    for name, paths in left.items():
        with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) as probe:
            probe.settimeout(_PROBE_TIMEOUT_S)
            try:
                probe.connect(str(rig_path(name, "sock")))
            except (ConnectionRefusedError, FileNotFoundError):
                for path in paths:
                    path.unlink(missing_ok=True)
            except OSError:
                continue  # the rig is running but busy
