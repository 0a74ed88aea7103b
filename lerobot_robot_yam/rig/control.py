"""Control client of a virtual rig, for tests, benchmarks and operators: connects to a rig, or starts and ends one.

    with RigControl.start(friction=0) as rig:
        bus = can.Bus(interface="yam_sim", channel="follower_left", rig=rig.name)
        rig.state()["arms"]["follower_left"]["q"]

An open client keeps the rig alive. A client must not be used from several threads at once.
"""

import contextlib
import itertools
import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.client import launch
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations

_TIMEOUT_S = 10.0
_END_TIMEOUT_S = 10.0
_numbers = itertools.count(1)


class RigControl(RigOperations):
    """Connection to a rig's control channel, with one method per operation.

    Args:
        rig: name of the rig, see `runtime_files.rig_name`.
        scene: scene to use if this call starts the rig.
        hold: whether this connection keeps the rig alive.
        options: scene options to use if this call starts the rig.

    Raises:
        RigError: the rig cannot be started.
        ConfigError: the scene or an option is unknown.
    """

    def __init__(self, rig: str | None = None, scene: str | Path | None = None, hold: bool = True, **options: Any):
        hello = {"kind": "control", "hold": hold}
        name = None if scene is None else str(scene)
        self._socket, self.name, answer = launch.connect_or_start(rig, hello, name, options)
        self._socket.settimeout(_TIMEOUT_S)
        self.pid: int = answer["pid"]

    @classmethod
    def start(cls, scene: str | Path | None = None, name: str | None = None, hold: bool = True, **options: Any) -> Self:
        """Start a new rig, under a new name unless `name` is given, and keep the rig alive."""
        return cls(name or f"rig-{os.getpid()}-{next(_numbers)}", scene, hold, **options)

    def request(self, op: str, **arguments: Any) -> dict[str, Any]:
        """Send a request to the rig and return the reply.

        Raises:
            RigError: the rig has ended or does not reply.
            ConfigError, BusError: the rig rejects the request.
        """
        message = launch.to_json({"op": op, **arguments})
        try:
            self._socket.send(message)
            packet = self._socket.recv(launch.MAX_PACKET)
        except BaseException as error:
            self.close()  # otherwise a late reply would be taken for that of the next request
            if isinstance(error, OSError):
                raise RigError(f"rig {self.name} does not answer ({error}); has its process ended?") from error
            raise
        if not packet:
            raise RigError(f"rig {self.name} has ended")
        return launch.checked(json.loads(packet))

    def wait_event(self, kind: str, timeout_s: float, since: int = 0, **details: Any) -> dict[str, Any]:
        """Return the first event with this kind and these details from number `since` on; wait until it occurs.

        Raises:
            RigError: no such event occurred within timeout_s.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            for event in self.events(since):
                since = event["number"] + 1
                if event["kind"] == kind and all(event.get(k) == v for k, v in details.items()):
                    return event
            if time.monotonic() > deadline:
                raise RigError(f"rig {self.name}: no event {kind} {details} within {timeout_s} s")
            time.sleep(0.02)

    def stats(self) -> dict[str, Any]:
        """Read the server's statistics.

        Returns:
            pid, cpu_s, uptime_s, sim_s, slips, wakes, realtime, clients; frames and overflows per channel.
        """
        return self.request("stats")

    def end(self) -> None:
        """End the rig immediately, with or without other clients."""
        self.request("end")

    def close(self) -> None:
        """Disconnect; the rig ends about a second after its last client disconnects. Idempotent."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@contextlib.contextmanager
def running_rig(**arguments: Any) -> Iterator[RigControl]:
    """Run a new rig, with arguments as for `RigControl.start`, until the block is left.

    Raises:
        RigError: another client still uses the rig at the end.
    """
    rig = RigControl.start(**arguments)
    try:
        yield rig
    finally:
        with contextlib.suppress(RigError):  # the block itself may have ended the rig
            if rig.stats()["clients"] == 1:
                rig.end()
        rig.close()
        wait_ended(rig)


def wait_ended(rig: RigControl) -> None:
    """Wait until a rig's process has exited. Raises RigError: it still runs, perhaps for another client."""
    deadline = time.monotonic() + _END_TIMEOUT_S
    while runs(rig.pid):
        if time.monotonic() > deadline:
            raise RigError(f"rig {rig.name} (process {rig.pid}) still runs; close its other clients")
        time.sleep(0.01)


def runs(pid: int) -> bool:
    """Return whether a process is alive; zombies do not count."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"
