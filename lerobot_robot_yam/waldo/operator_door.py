"""The operator's way to a controller of this computer: arm and land, which no client over TCP can ask for.

A socket in the runtime directory, which is open to its user alone.
"""

import asyncio
import contextlib
import logging
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path

from lerobot_robot_yam.errors import ControllerError, YamError
from lerobot_robot_yam.system.runtime_files import runtime_dir
from lerobot_robot_yam.waldo.wire import MOST_BYTES, decode, encode

logger = logging.getLogger(__name__)

_FIRST_S = 120.0  # for an answer: an arm may have to find its gripper's stops, or fold from far away


def door_path(port: int) -> Path:
    """The socket of the controller that serves a port. Raises ConfigError: there can be no runtime directory."""
    return runtime_dir() / f"waldo-{port}"


class OperatorDoor:
    """The controller's side.

    Args:
        port: that the controller serves.
        acts: what an operator may ask for; each gives words to show.
    """

    def __init__(self, port: int, acts: dict[str, Callable[[], Awaitable[str]]]):
        self._path, self._acts = door_path(port), acts
        self._server: asyncio.Server | None = None

    async def open(self) -> None:
        """Let the operator in; the port is ours, so a socket that is there was left by a controller that died."""
        self._path.unlink(missing_ok=True)
        self._server = await asyncio.start_unix_server(self._serve, self._path)
        self._path.chmod(0o600)

    def close(self) -> None:
        """Idempotent."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
            self._path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        reply = {}
        try:
            reply["result"] = await self._acts[decode(await reader.readline())["do"]]()
        except (YamError, ValueError, KeyError) as error:
            reply["refused"] = str(error)
        except Exception as error:  # a defect: the operator must not wait for an answer that never comes
            logger.exception("an act of the operator failed")
            reply["refused"] = f"it failed ({type(error).__name__}); see the log of the controller"
        with contextlib.suppress(OSError):
            writer.write(encode(reply))
            await writer.drain()
            writer.close()


def ask_operator_door(port: int, act: str) -> str:
    """Have the controller of this computer that serves `port` do something; what it says.

    Raises:
        ControllerError: there is none, or it refused.
    """
    with socket.socket(socket.AF_UNIX) as line:
        line.settimeout(_FIRST_S)
        try:
            line.connect(str(door_path(port)))
            line.sendall(encode({"do": act}))
            answer = b""
            while not answer.endswith(b"\n") and (piece := line.recv(MOST_BYTES)):
                answer += piece
        except OSError as error:
            raise ControllerError(
                f"no controller of yours serves port {port} on this computer ({error}); start it first: "
                "yam-waldo --hardware --channel …"
            ) from error
    if not answer:
        raise ControllerError(f"{act}: the controller ended before it was done; see its terminal")
    reply = decode(answer)
    if "refused" in reply:
        raise ControllerError(reply["refused"])
    return str(reply["result"])
