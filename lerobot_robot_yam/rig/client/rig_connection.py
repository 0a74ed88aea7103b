"""Connection of a control client to a virtual rig: reach it or start it, ask it, end it."""

import contextlib
import itertools
import json
import os
import socket
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.client import launch

_TIMEOUT_S = 10.0
_numbers = itertools.count(1)


class RigConnection:
    """A connection to a rig's control channel.

    Args:
        rig: which rig, see `runtime.rig_name`.
        scene: scene of a rig that is started for us.
        options: scene options of a rig that is started for us.

    Raises:
        RigError: the rig cannot be started.
        ConfigError: unknown scene or option.
    """

    def __init__(self, rig: str | None = None, scene: str | Path | None = None, hold: bool = True, **options: Any):
        hello = {"kind": "control", "hold": hold}
        name = None if scene is None else str(scene)
        self._socket, self.name, answer = launch.connect_or_start(rig, hello, name, options)
        self._socket.settimeout(_TIMEOUT_S)
        self.pid: int = answer["pid"]

    @classmethod
    def start(cls, scene: str | Path | None = None, name: str | None = None, hold: bool = True, **options: Any) -> Self:
        """Start a rig of its own (a new name unless one is given) and hold it alive."""
        return cls(name or f"rig-{os.getpid()}-{next(_numbers)}", scene, hold, **options)

    def request(self, op: str, **arguments: Any) -> dict[str, Any]:
        """Ask the rig; returns its answer.

        Raises:
            RigError: the rig has ended or does not answer.
            ConfigError, BusError: the rig refuses.
        """
        message = json.dumps({"op": op, **arguments}, default=_plain).encode()
        try:
            self._socket.send(message)
            packet = self._socket.recv(launch.MAX_PACKET)
        except BaseException as error:
            self.close()  # a late answer would be taken for the next one
            if isinstance(error, OSError):
                raise RigError(f"rig {self.name} does not answer ({error}); has its process ended?") from error
            raise
        if not packet:
            raise RigError(f"rig {self.name} has ended")
        answer: dict[str, Any] = json.loads(packet)
        if "error" in answer:
            launch.raise_remote(answer)
        return answer

    def end(self) -> None:
        """End the rig at once, whoever uses it."""
        self.request("end")

    def close(self) -> None:
        """Leave; the rig ends about a second after its last client. Idempotent."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")
