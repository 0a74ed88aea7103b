"""One simulated CAN channel: its wire, the devices on it and the listening clients.

As on a real bus, a client receives the frames of the others but not its own, and none sent before it opened the
channel. The frames of a packet pass the wire one after the other, followed by the replies, which return as one packet.
A client that does not read loses packets once its socket is full. The channel counts lost packets and never blocks.
"""

import contextlib
import random
import socket
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from lerobot_robot_yam.damiao import codec
from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID
from lerobot_robot_yam.damiao.tables import POSITION_VELOCITY_OFFSET, REGISTER_ID, VELOCITY_OFFSET
from lerobot_robot_yam.rig.bus.adapter import Adapter, Listener
from lerobot_robot_yam.rig.bus.link_state import BUS_OFF_FRAME_ID, Link, LinkState
from lerobot_robot_yam.rig.bus.whole_tick import WholeTick
from lerobot_robot_yam.rig.devices import packets
from lerobot_robot_yam.rig.devices.packets import Frame, Wire
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor

_BACKLOG_S = 0.05  # backlog of the wire above which packets are dropped, s: about the full queue of a real adapter
_FOREIGN_KP, _FOREIGN_KD = 10.0, 1.0  # gains, Nm/rad and Nm s/rad, of a foreign driver that holds a motor
_FOREIGN_AT_ONCE = 50  # maximum frames of a foreign driver per poll; after a pause of the rig the excess is skipped
PAYLOADS = ("hold", "zero")


@dataclass
class ForeignDriver:
    """Another computer on the wire, which a lock on this computer cannot exclude; it sends frames to one identifier.

    payload: "hold", an MIT command to stay at the motor's position; or "zero", eight zero bytes, which a motor decodes
    as the lower end of each range. An identifier without a motor always gets zeros. since_s: start, on the rig's clock.
    """

    ident: int
    rate_hz: float
    payload: str
    since_s: float
    sent: int = 0

    def due(self, now_s: float) -> int:
        """Return the number of frames to send now, and count them as sent."""
        behind = max(0, int((now_s - self.since_s) * self.rate_hz) - self.sent)
        self.sent += behind
        return min(behind, _FOREIGN_AT_ONCE)


class Channel:
    """Motors, clients and (on leaders) a handle on one wire.

    latency_s: delay of the adapter in each direction, s. seed: seed for the choice of lost and garbled frames.
    """

    def __init__(self, name: str, motors: Sequence[SimMotor], handle: SimHandle | None, latency_s: float, seed: int):
        self.name, self.motors, self.handle = name, list(motors), handle
        self.adapter = Adapter(latency_s)
        self.link = Link()  # see `set_link`
        self.cable_out = False  # whether frames are lost in both directions, without an error
        self.foreign: ForeignDriver | None = None
        self.clients: list[Listener] = []
        self.wire = Wire()
        self.overflows = 0  # packets lost because a queue was full, in either direction
        self.trace: deque[tuple[float, float, int, int]] | None = None  # time sent, received; identifier; first byte
        self._random = random.Random(seed)
        self._by_id: dict[int, tuple[SimMotor, int]] = {}
        self._tick = WholeTick(self.motors, handle) if self.motors else None
        self.identifiers_changed()

    def identifiers_changed(self) -> None:
        """Rebuild the table of command identifiers; must be called after each change of an ESC_ID."""
        self._by_id = {
            motor.can_id + offset: (motor, offset)
            for motor in self.motors
            for offset in (0, POSITION_VELOCITY_OFFSET, VELOCITY_OFFSET)
        }

    @property
    def tick_size(self) -> int:
        """Size of a packet that holds a whole tick, bytes; 0 without motors."""
        return 0 if self._tick is None else self._tick.size

    def receive_packet(self, sender: Listener, packet: bytes, now_s: float) -> None:
        """Process a packet of frames from a client, in the format of `packets`.

        Raises:
            BusError: the packet size is not a multiple of the record size.
        """
        if self._tick is not None and self._is_plain(sender, now_s):
            answer = self._tick.answer(packet, now_s, self.wire, self.adapter)
            if answer is not None:
                self._send(sender, answer)
                return
        self.receive(sender, packets.unpack(packet), now_s)

    def _is_plain(self, sender: Listener, now_s: float) -> bool:
        """Return whether `WholeTick` may reply: one client, no fault or delay, no trace, and a free wire."""
        adapter, handle = self.adapter, self.handle
        return (
            len(self.clients) == 1
            and self.clients[0] is sender
            and not (self.cable_out or self.link.state or adapter.waits)
            and self.trace is None
            and (handle is None or not handle.silent)
            and self.wire.free_at_s - (now_s + adapter.latency_s) <= _BACKLOG_S
        )

    def receive(self, sender: Listener, frames: Sequence[Frame], now_s: float) -> None:
        """Process frames from a client; they reach the wire at once, or after the adapter's latency."""
        if self.cable_out or self.link.state or sender not in self.clients:
            return
        if self.trace is not None:
            self.trace.extend((f.stamp_s, now_s, f.id, f.data[0] if f.data else 0) for f in frames)
        latency_s = self.adapter.latency_s
        timed = [(packets.send_time(frame.stamp_s, now_s) + latency_s, frame) for frame in frames]
        if self.adapter.waits:
            self.adapter.put(sender, timed)
        else:
            self._transmit(sender, timed, now_s + latency_s)

    def pass_on(self, until_s: float) -> None:
        """Transmit the delayed frames that reach the wire by `until_s`."""
        for sender, timed in self.adapter.take(until_s):
            if not (self.cable_out or self.link.state) and sender in self.clients:
                self._transmit(sender, timed, timed[0][0])

    def _transmit(self, sender: Listener, timed: Sequence[tuple[float, Frame]], now_s: float) -> None:
        """Transmit frames, each with the time at which it is ready, and the replies to them."""
        if self.wire.free_at_s - now_s > _BACKLOG_S:
            self.overflows += 1
            return
        transmit = self.wire.transmit
        heard = [(transmit(ready_s), frame) for ready_s, frame in timed]
        replies = [
            (transmit(through_s), reply) for through_s, frame in heard for reply in self._answers(frame, through_s)
        ]
        if len(self.clients) > 1:
            self._deliver([client for client in self.clients if client is not sender], heard)
        if replies:
            self._deliver(self.clients, replies)

    def emit(self, frame: Frame, now_s: float) -> None:
        """Deliver a frame that a device sends without a request."""
        if not (self.cable_out or self.link.state):
            self._deliver(self.clients, [(self.wire.transmit(now_s), frame)])

    def set_link(self, now_s: float, **change: bool) -> None:
        """Change the interface state: down=, gone= or bus_off=; clients get the errors of `ClientLink`.

        gone=True also closes the clients' sockets permanently, as unplugging an adapter does.
        """
        before = self.link.state
        self.link.change(**change)
        if self.link.state == before:
            return
        if self.link.state == LinkState.BUS_OFF:
            for client in self.clients:
                self._hand_over(client, [Frame(now_s, BUS_OFF_FRAME_ID, bytes(8), packets.FLAG_ERROR)])
        for client in self.clients:
            with contextlib.suppress(OSError):  # full or closed: such a client is not blocked in a read
                client.send(packets.WAKE, socket.MSG_DONTWAIT)
        if self.link.state == LinkState.GONE:
            self.clients.clear()

    def poll(self, now_s: float) -> None:
        """Send the frames that are due: the handle's unsolicited reports and those of a foreign driver."""
        if self.handle is not None:
            for report in self.handle.due_reports(now_s):
                self.emit(report, now_s)
        if self.foreign is not None:
            for _ in range(self.foreign.due(now_s)):
                self._hear_foreign(self.foreign, now_s)

    def _hear_foreign(self, driver: ForeignDriver, now_s: float) -> None:
        """Let the motors obey and reply to a foreign driver's frame, whatever the state of the rig's own link."""
        data = bytes(8)
        motor, offset = self._by_id.get(driver.ident, (None, 0))
        if driver.payload == "hold" and motor is not None and offset == 0:
            position = codec.decode_feedback(motor.kind, motor.feedback(now_s).data).position
            data = codec.encode_mit(motor.kind, position, 0.0, _FOREIGN_KP, _FOREIGN_KD, 0.0)
        frame = Frame(now_s, driver.ident, data)
        self.emit(frame, now_s)
        for answer in self._answers(frame, now_s):
            self.emit(answer, now_s)

    def _answers(self, frame: Frame, at_s: float) -> Sequence[Frame]:
        if frame.flags:  # devices ignore extended and remote frames
            return ()
        entry = self._by_id.get(frame.id)
        offset: int | None
        if entry is not None:
            motor, offset = entry
        elif frame.id == REGISTER_ID:
            entry = self._by_id.get(int.from_bytes(frame.data[:2], "little"))
            if entry is None or entry[1]:
                return ()
            motor, offset = entry[0], None
        elif frame.id == REQUEST_ID and self.handle is not None:
            return self.handle.requests(frame.data)
        else:
            return ()
        answers, twin = self._answers_of(motor, offset, frame.data, at_s), motor.twin
        return answers if twin is None else (*answers, *self._answers_of(twin, offset, frame.data, at_s))

    def _answers_of(self, motor: SimMotor, offset: int | None, data: bytes, at_s: float) -> Sequence[Frame]:
        """Return one motor's replies to a command, or to a register request if `offset` is None."""
        if motor.faults.unheard(self._random):
            return ()
        if offset is not None:
            answer = motor.command(offset, data, at_s)
        else:
            can_id = motor.can_id
            answer = motor.request(data, at_s)
            if motor.can_id != can_id:
                self.identifiers_changed()
        if answer is None:
            return ()
        return motor.faults.spoil(answer, self._random) if motor.faults.any() else (answer,)

    def _deliver(self, clients: Sequence[Listener], timed: Sequence[tuple[float, Frame]]) -> None:
        """Send frames to clients, each with the time at which the wire delivers it."""
        adapter = self.adapter
        frames = [Frame(adapter.arrival_s(at_s), frame.id, frame.data, frame.flags) for at_s, frame in timed]
        for client in clients:
            self._hand_over(client, frames)

    def _hand_over(self, client: Listener, frames: Sequence[Frame]) -> None:
        self._send(client, packets.pack(frames))

    def _send(self, client: Listener, packet: bytes) -> None:
        try:
            client.send(packet, socket.MSG_DONTWAIT)
        except BlockingIOError:
            self.overflows += 1
        except OSError:
            pass  # the client has disconnected; the server drops it
