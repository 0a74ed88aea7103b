"""Control client of a virtual rig, for tests, benches and operators.

    with RigControl.start(friction=0) as rig:
        bus = can.Bus(interface="yam_sim", channel="follower_left", rig=rig.name)
        rig.state()["arms"]["follower_left"]["q"]

While it is open the rig stays alive. Not for use by several threads at once. Times are simulated seconds unless a
key says `monotonic_s`; lengths in m, angles in rad, forces in N.
"""

import contextlib
import itertools
import json
import os
import socket
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig import launch
from lerobot_robot_yam.rig.scene import Scene, load_scene

_TIMEOUT_S = 10.0
_STAMP_UNIT_S = 1e-4
_numbers = itertools.count(1)


def sample_age_s(temp_mos: int, temp_rotor: int, now_s: float) -> float:
    """Age of a feedback sample whose temperature bytes carry its time (option stamp_temperatures).

    Unambiguous up to 6.5 s; in steps of 0.1 ms.
    """
    stamp = int(temp_mos) << 8 | int(temp_rotor)
    return ((int(now_s / _STAMP_UNIT_S) - stamp) & 0xFFFF) * _STAMP_UNIT_S


class RigControl:
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
        self._scene = (name, dict(options))

    @classmethod
    def start(
        cls, scene: str | Path | None = None, name: str | None = None, hold: bool = True, **options: Any
    ) -> "RigControl":
        """Start a rig of its own (a new name unless one is given) and hold it alive."""
        return cls(name or f"rig-{os.getpid()}-{next(_numbers)}", scene, hold, **options)

    def request(self, op: str, **arguments: Any) -> dict[str, Any]:
        """Ask the rig; returns its answer.

        Raises:
            RigError: the rig has ended or does not answer.
            ConfigError, BusError: the rig refuses.
        """
        try:
            self._socket.send(json.dumps({"op": op, **arguments}, default=_plain).encode())
            packet = self._socket.recv(launch.MAX_PACKET)
        except OSError as error:
            raise RigError(f"rig {self.name} does not answer ({error}); has its process ended?") from error
        if not packet:
            raise RigError(f"rig {self.name} has ended")
        answer: dict[str, Any] = json.loads(packet)
        if "error" in answer:
            launch.raise_remote(answer)
        return answer

    # what is so

    def scene(self) -> dict[str, Any]:
        """Arms with their placement, places, props; as the rig runs them."""
        return self.request("scene")

    def local_scene(self) -> Scene:
        """The scene as this client asked for it, to build the same model; only right if this client started the rig."""
        return load_scene(*self._scene)

    def state(self, bodies: bool = False) -> dict[str, Any]:
        """The true state of the world.

        Returns:
            sim_s, monotonic_s; arms[channel]: q and dq (n,), opening 0 … 1 or None, trigger, buttons, held,
            resists (the hand has let go of an arm that worked against it), clients,
            motors[name]: {id, enabled, fault, torque_nm, motor_rad}, tcp_site and grasp_site:
            {pos (3,), mat (9,)}; props[name]: {pos, quat}; with `bodies`, bodies[name]: position (3,).
        """
        return self.request("state", bodies=bodies)

    def stats(self) -> dict[str, Any]:
        """Server's pid, cpu_s, uptime_s, sim_s, slips, wakes, realtime, frames and overflows per channel."""
        return self.request("stats")

    def events(self, since: int = 0) -> list[dict[str, Any]]:
        """All events from number `since` on, each with number, sim_s, monotonic_s, kind and details."""
        found: list[dict[str, Any]] = []
        while True:
            chunk = self.request("events", since=since)["events"]
            if not chunk:
                return found
            found += chunk
            since = chunk[-1]["number"] + 1

    def wait_event(self, kind: str, timeout_s: float, since: int = 0, **details: Any) -> dict[str, Any]:
        """The first event of that kind and details from number `since` on; waits for it.

        Raises:
            RigError: none within timeout_s.
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

    def trace_start(self, channel: str) -> None:
        """From now on record every frame that clients send to the channel."""
        self.request("trace", channel=channel, start=True)

    def trace(self, channel: str) -> list[tuple[float, float, int, int]]:
        """(sent, arrived at the rig, identifier, first data byte) of every frame since `trace_start`; monotonic s."""
        found: list[tuple[float, float, int, int]] = []
        while chunk := self.request("trace", channel=channel, since=len(found))["frames"]:
            found += [(sent, arrived, ident, first) for sent, arrived, ident, first in chunk]
        return found

    # what tests change

    def place(self, prop: str, pos: Sequence[float], quat: Sequence[float] = (1, 0, 0, 0)) -> None:
        """Put a prop somewhere, at rest."""
        self.request("place", prop=prop, pos=pos, quat=quat)

    def set_pose(self, channel: str, q: Sequence[float] | None = None, opening: float | None = None) -> None:
        """Teleport an arm (n,) and its gripper (0 closed … 1 open), at rest."""
        self.request("set_pose", channel=channel, q=q, opening=opening)

    def push(self, channel: str, body: str, force: Sequence[float], seconds: float) -> None:
        """Push a body of an arm ("link4") with a force (3,) in world axes."""
        self.request("push", channel=channel, body=body, force=force, seconds=seconds)

    def fault(self, channel: str, motor: str | int | None, kind: str, value: Any = True, **details: Any) -> None:
        """Make something fail.

        motor: name or CAN id; None for all motors of the channel. kinds: "silent" (bool), "drop_next" (answers),
        "loss_rate" (0 … 1), "delay_s", "duplicate" (bool), "temperatures_c" ([power stage, coil]),
        "nibble" (fault code; sticky=True survives CLEAR), "register" (register=number), and for the whole channel
        "bus_off" (bool), "latency_s", "handle_silent" (bool).
        """
        self.request("fault", channel=channel, motor=motor, kind=kind, value=value, **details)

    def clear_faults(self, channel: str) -> None:
        """Undo what `fault` did to the channel's links; registers and latched fault codes stay."""
        self.request("clear_faults", channel=channel)

    def cut_torque(self, channel: str) -> None:
        """Disable every motor of the arm at once, as an emergency stop of its supply would."""
        self.request("cut_torque", channel=channel)

    def trigger(self, channel: str, value: float) -> None:
        """Squeeze a handle's trigger: 0 released … 1."""
        self.request("trigger", channel=channel, value=value)

    def buttons(self, channel: str, sync: bool = False, record: bool = False) -> None:
        """Hold a handle's two buttons down, or not."""
        self.request("buttons", channel=channel, value=[sync, record])

    def hand(
        self,
        channel: str,
        times: Sequence[float],
        q: Sequence[Sequence[float]],
        trigger: float | Sequence[float] = 0.0,
    ) -> None:
        """Grip a leader and pull it along q (k, n) at times (k,) s from now, with limited force, then hold it."""
        self.request("hand", channel=channel, times=times, q=q, trigger=trigger)

    def release(self, channel: str) -> None:
        """Let a leader go."""
        self.request("hand", channel=channel, release=True)

    def log(self, kind: str, **details: Any) -> None:
        """Add an event to the rig's log."""
        self.request("log", kind=kind, details=details)

    # life time

    def end(self) -> None:
        """End the rig at once, whoever uses it."""
        self.request("end")

    def close(self) -> None:
        """Leave; the rig ends about a second after its last client. Idempotent."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def __enter__(self) -> "RigControl":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@contextlib.contextmanager
def running_rig(**arguments: Any) -> Iterator[RigControl]:
    """A rig of one's own (arguments as for `RigControl.start`) that has ended when the block is left.

    Raises:
        RigError: at the end, somebody still used it.
    """
    rig = RigControl.start(**arguments)
    try:
        yield rig
    finally:
        with contextlib.suppress(RigError):  # it may have ended in the block
            if rig.stats()["clients"] == 1:
                rig.end()
        rig.close()
        wait_ended(rig)


def wait_ended(rig: RigControl, timeout_s: float = 10.0) -> None:
    """Wait until a rig's process is gone.

    Raises:
        RigError: it is not; somebody else may still use it.
    """
    deadline = time.monotonic() + timeout_s
    while runs(rig.pid):
        if time.monotonic() > deadline:
            raise RigError(f"rig {rig.name} (process {rig.pid}) still runs; who uses it?")
        time.sleep(0.01)


def runs(pid: int) -> bool:
    """Whether a process is alive; one that init has not collected yet is not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")
