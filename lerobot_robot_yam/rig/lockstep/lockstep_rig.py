"""Virtual rig in lock-step in this process: its time advances only while a caller sleeps on its clock.

    rig = LockstepRig("tasks", arms=["follower_left", "follower_right"])
    bus = can.Bus(interface="yam_lockstep", channel="follower_left", rig=rig.name)

The rig has the world, motors and wires of the live rig, but no sockets, and does not depend on the computer's clock or
load: the same calls give identical bits, as fast as the machine allows.
"""

import itertools
import json
import os
import socket
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import can

from lerobot_robot_yam.errors import BusError, ConfigError
from lerobot_robot_yam.rig.bus.link_state import ClientLink
from lerobot_robot_yam.rig.client.launch import no_channel, rig_path, to_json
from lerobot_robot_yam.rig.devices import packets
from lerobot_robot_yam.rig.devices.packets import Frame, message_of, pack_messages
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations, perform
from lerobot_robot_yam.rig.world.world import WorldBlock

BEGIN_S = 100.0  # the rig's time at its start
_STEP_S = 0.004  # maximum time simulated in one go, s, as in the live rig
_PATIENCE_S = 60.0  # maximum wait in `recv` without a timeout

_rigs: dict[str, "LockstepRig"] = {}
_numbers = itertools.count(1)


def find_lockstep(name: str | None) -> "LockstepRig | None":
    """Return the rig in lock-step with this name in this process, or None."""
    return _rigs.get(name or "")


class LockstepRig(RigOperations):
    """World, channels and clock of a rig in lock-step.

    Args:
        scene, options: see `scene.load_scene`.

    Attributes:
        restarts: number of calls of `restart`.
        at_close: callbacks that `close` calls.

    Raises:
        ConfigError: the scene or an option is unknown.
    """

    def __init__(self, scene: str | Path | None = None, **options: Any):
        self.name = f"lockstep-{os.getpid()}-{next(_numbers)}"
        self.scene_name = None if scene is None else str(scene)
        self.options = dict(options)
        self._scene = load_scene(self.scene_name, options)
        self.device = RigDevice(self._scene, self)
        self._now_s = BEGIN_S
        self.device.world.start(BEGIN_S)
        self._block = WorldBlock(rig_path(self.name, "world"), self.device.world)
        self.restarts = 0
        self.at_close: list[Callable[[], None]] = []
        _rigs[self.name] = self

    def now(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Advance the rig's time by simulating the world."""
        if not seconds >= 0.0:
            raise ValueError(f"a rig cannot sleep {seconds!r} s")
        until_s = self._now_s + seconds
        while self._now_s < until_s:
            self._now_s = min(self._now_s + _STEP_S, until_s)
            self.device.advance(self._now_s)

    def request(self, op: str, **arguments: Any) -> dict[str, Any]:
        answer = perform(self.device, json.loads(to_json({"op": op, **arguments})))
        plain: dict[str, Any] = json.loads(to_json(answer))
        return plain

    def restart(self) -> None:
        """Return to the initial time and world. Open buses are unusable afterwards."""
        for channel in self.device.channels.values():
            channel.clients.clear()
        self.device = RigDevice(self._scene, self)
        self._now_s = BEGIN_S
        self.device.world.start(BEGIN_S)
        self.restarts += 1

    def show(self) -> None:
        """Publish the current state of the world to the renderer."""
        self._block.publish(self.device.world)

    def close(self) -> None:
        """End the rig. Idempotent."""
        if _rigs.pop(self.name, None) is not None:
            while self.at_close:
                self.at_close.pop()()
            self._block.close()


class LockstepBus(can.BusABC):
    """One client of one channel of a rig in lock-step; python-can interface `yam_lockstep`.

    Args:
        channel: a channel of the rig's scene.
        can_filters: see `can.BusABC`.
        rig: name of a `LockstepRig` in this process.

    Raises:
        ConfigError: there is no such rig.
        BusError: there is no such channel.
    """

    def __init__(self, channel: str, can_filters: Any = None, *, rig: str | None = None, **foreign_options: Any):
        found = find_lockstep(rig)
        if found is None:
            raise ConfigError(f"{channel}: this process has no rig in lock-step {rig!r}; start a LockstepRig first")
        if channel not in found.device.channels:
            raise BusError(no_channel(str(rig), channel, found.device.channels))
        self.clock = found
        self.channel_info = f"yam_lockstep channel {channel} of rig {rig}"
        self._wire = found.device.channels[channel]
        self._link = ClientLink(self._wire.link.word, self._wire.link.unplugs)
        self._arrived: deque[Frame] = deque()
        self._mailbox = _Mailbox(self._arrived)
        self._wire.clients.append(self._mailbox)
        super().__init__(channel=channel, can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.send_many((msg,))

    def send_many(self, messages: Sequence[can.Message]) -> None:
        """Queue frames for the wire, back to back.

        Raises:
            BusError: the rig has been restarted.
            can.CanOperationError: the interface is down, gone or blocked, see `RigControl.fault`.
        """
        if not self._link.check_send(len(messages)):
            return
        if self._mailbox not in self._wire.clients:
            raise BusError(f"{self.channel_info}: no such device; was the rig restarted?")
        now = self.clock.now()
        self._wire.receive_packet(self._mailbox, pack_messages(messages, now), now)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame; the wait advances the rig's clock.

        Raises:
            can.CanOperationError: the interface is down or gone.
        """
        clock, arrived = self.clock, self._arrived
        deadline = clock.now() + (_PATIENCE_S if timeout is None else timeout)
        while True:
            self._link.check_receive()
            now = clock.now()
            if arrived and arrived[0].stamp_s <= now:
                message = message_of(arrived.popleft(), self._wire.name)
                if self._matches_filters(message):
                    return message
                continue
            if now >= deadline:
                return None
            next_s = arrived[0].stamp_s if arrived else min(now + _STEP_S, self._wire.adapter.due_s)
            until = min(deadline, max(next_s, now))
            clock.sleep(until - now)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), True

    def shutdown(self) -> None:
        """Leave the channel. Idempotent."""
        super().shutdown()
        if self._mailbox in self._wire.clients:
            self._wire.clients.remove(self._mailbox)


class _Mailbox:
    def __init__(self, arrived: deque[Frame]):
        self._arrived = arrived

    def send(self, data: bytes, flags: int = socket.MSG_DONTWAIT, /) -> int:
        if data != packets.WAKE:
            self._arrived.extend(packets.unpack(data))
        return len(data)
