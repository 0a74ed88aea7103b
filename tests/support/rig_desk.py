"""A rig without process and without waiting: the simulated device in this process, its time moved by the test."""

import functools
import socket
from typing import Any

from lerobot_robot_yam.damiao import codec
from lerobot_robot_yam.damiao.codec import Feedback, SpecialCommand
from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.devices import packets
from lerobot_robot_yam.rig.devices.packets import Frame
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.scene.scene import Scene, load_scene
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations, perform


@functools.cache
def _scene(channel: str, **options: Any) -> Scene:
    """Read once: that takes most of the time that a desk takes."""
    return load_scene(options={"arms": [channel], **options})


class Desk(RigOperations):
    """One arm of the scene, one client on its channel."""

    def __init__(self, channel: str = "follower_left", **options: Any):
        self.device = RigDevice(_scene(channel, **options))
        self.channel: Channel = self.device.channels[channel]
        self.now_s = 100.0
        self.device.world.start(self.now_s)
        self._ours, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.channel.clients.append(self._theirs)

    def request(self, op: str, **arguments: Any) -> dict[str, Any]:
        return perform(self.device, {"op": op, **arguments})

    def close(self) -> None:
        self._ours.close()
        self._theirs.close()

    def motor(self, can_id: int) -> SimMotor:
        return next(motor for motor in self.channel.motors if motor.can_id == can_id)

    def run(self, seconds: float) -> None:
        """Let simulated time pass."""
        end = self.now_s + seconds
        while self.now_s < end - 1e-9:
            self.now_s += 0.004
            self.device.advance(self.now_s)

    def send(self, *frames: tuple[int, bytes]) -> list[Frame]:
        """Send frames as one packet; returns the answers."""
        self.channel.receive(self._theirs, [Frame(self.now_s, ident, data) for ident, data in frames], self.now_s)
        return self.heard()

    def heard(self) -> list[Frame]:
        """What has arrived since the last call."""
        found: list[Frame] = []
        while True:
            try:
                packet = self._ours.recv(1 << 17, socket.MSG_DONTWAIT)
                found += packets.unpack(packet) if packet != packets.WAKE else []
            except BlockingIOError:
                return found

    def special(self, can_id: int, command: SpecialCommand) -> Feedback:
        (answer,) = self.send((can_id, command.value))
        return codec.decode_feedback(self.motor(can_id).kind, answer.data)

    def mit(self, can_id: int, q: float = 0, dq: float = 0, kp: float = 0, kd: float = 0, tau: float = 0) -> Feedback:
        kind = self.motor(can_id).kind
        (answer,) = self.send((can_id, codec.encode_mit(kind, q, dq, kp, kd, tau)))
        return codec.decode_feedback(kind, answer.data)
