"""All motors of one CAN bus: send one command to each, then collect their replies by CAN id.

Frames that have already arrived are processed before each send, so that old data cannot pile up in the socket.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from types import MappingProxyType
from typing import Any

import can
import numpy as np

from lerobot_robot_yam.damiao.bus_port import BusPort, data_message, is_classic_data
from lerobot_robot_yam.damiao.codec import SpecialCommand, encode_mit, encode_velocity, pack_mit, ranges_of
from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID, HandleEncoder, encode_report_request
from lerobot_robot_yam.damiao.motor_spec import MotorSpec, check_specs
from lerobot_robot_yam.damiao.plausibility import PERIOD_S
from lerobot_robot_yam.damiao.receiver import FeedbackStore, Receiver
from lerobot_robot_yam.damiao.registers import (
    REGISTERS,
    decode_value,
    encode_read,
    encode_refresh,
)
from lerobot_robot_yam.damiao.reply_matching import Request
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S, REGISTER_ID, ControlMode
from lerobot_robot_yam.errors import ActionError, BusError, MotorError
from lerobot_robot_yam.system.few_values import any_of

ENABLE_PAUSE_S = 0.003  # pause before each ENABLE, s, as in the vendor's driver
CLEAR_REPEATS = 3  # number of times that CLEAR is sent, as in the vendor's driver
# Pause after these commands, s, until they and their replies have left the wire: the default transmit queue of a link
# has room for 20 frames only.
_CLEAR_PAUSE_S = 2 * CLEAR_REPEATS * FRAME_TIME_S
# A connection sends 110 requests. If 1 % of all frames are lost, three attempts per request fail one connection in
# 1,100, five fail one in 3 million.
_REGISTER_ATTEMPTS = 5


def _of(path: str) -> Any:
    """Create a read-only property that returns the attribute `path` of a part of the chain."""
    return property(attrgetter(path))


class MotorChain:
    """All motors (and optionally the handle encoder) on one CAN bus. For use from one thread only.

    Args:
        period_s: period of the loop that sends commands, s.

    Attributes:
        feedback: newest state of the motors; its arrays are also attributes of the chain.
        round_trip: delays of the adapter.
        expected_wire_s: time for which one exchange occupies the wire: two frames per motor, two for the handle.
        missed: (n,) number of consecutive requests without a reply.
        all_answered: whether every motor replied to the last `send` that was collected.
        foreign_commands: number of frames that another driver sent to these motors.
        foreign: CAN id -> number of frames that belong to no motor or handle of this chain.
        error_frames: number of CAN error frames.
    """

    position_rad: np.ndarray = _of("feedback.position_rad")
    velocity_rad_s: np.ndarray = _of("feedback.velocity_rad_s")
    torque_nm: np.ndarray = _of("feedback.torque_nm")
    temp_mos_c: np.ndarray = _of("feedback.temp_mos_c")
    temp_rotor_c: np.ndarray = _of("feedback.temp_rotor_c")
    stamp_s: np.ndarray = _of("feedback.stamp_s")
    asked_s: np.ndarray = _of("feedback.asked_s")
    fault: np.ndarray = _of("feedback.fault")
    distrusted: np.ndarray = _of("feedback.distrusted")
    all_normal: bool = _of("feedback.all_normal")
    foreign_commands: int = _of("_receiver.foreign_commands")
    foreign: dict[int, int] = _of("_receiver.foreign")
    error_frames: int = _of("_receiver.error_frames")

    def __init__(
        self,
        bus: can.BusABC,
        motors: Sequence[MotorSpec],
        *,
        channel: str,
        encoder: HandleEncoder | None = None,
        period_s: float = PERIOD_S,
    ):
        """Check the motors. Raises ConfigError: names or ids are not unique, or a type is unknown."""
        check_specs(motors, channel)
        self.channel, self.motors, self.encoder = channel, tuple(motors), encoder
        self._ranges = [ranges_of(spec.type) for spec in self.motors]
        self._port = BusPort(bus, channel)
        self.clock = self._port.clock
        self._receiver = Receiver(self._port, self.motors, encoder, period_s)
        self.feedback, self.round_trip = self._receiver.feedback, self._receiver.round_trip
        self._requests = self._receiver.requests
        # Reused every tick: a bus copies what it queues.
        self._messages = [data_message(spec.command_id, bytes(8)) for spec in self.motors]
        if encoder is not None:
            self._messages.append(data_message(REQUEST_ID, encode_report_request()))
        self._turning = [i for i, spec in enumerate(self.motors) if spec.mode is ControlMode.VELOCITY]
        self.expected_wire_s = 2 * len(self._messages) * FRAME_TIME_S
        self.missed: np.ndarray = np.zeros(len(self.motors), dtype=int)
        self.all_answered = False
        self._lost_before = 0  # number of lost replies at the last `collect`

    def __len__(self) -> int:
        return len(self.motors)

    @property
    def duplicates(self) -> np.ndarray:
        """Number of unrequested replies (n,), a sign of duplicate ids; dropped, since their age is unknown."""
        return np.array(self._requests.duplicates)

    @property
    def lost(self) -> np.ndarray:
        """Number of replies that never arrived (n,)."""
        return np.array(self._requests.lost)

    def silence_s(self, now: float) -> np.ndarray:
        """Return the time since each motor's last sample (n,), s, less the adapter's round-trip delay."""
        return now - self.stamp_s - 2.0 * self.round_trip.one_way_s

    def drain(self) -> None:
        """Process all frames that have already arrived, without waiting."""
        self._receiver.drain()

    def listen(self) -> FeedbackStore:
        """Return a second feedback store, updated until `stop_listening`; it checks all readings anew."""
        self._receiver.trial = trial = self._receiver.new_store()
        return trial

    def stop_listening(self) -> None:
        """Stop updating the store that `listen` returned."""
        self._receiver.trial = None

    def send(self, commands: np.ndarray, instead: Mapping[int, SpecialCommand] = MappingProxyType({})) -> None:
        """Send one command per motor, then the report request to the handle, without waiting.

        The torques compensate for the rounding of positions and velocities in the frames, see `codec.pack_mit`. A motor
        in velocity mode receives only the velocity of its row.
        After losses a motor is skipped in some ticks, see `reply_matching`; that motor keeps its last command.

        Args:
            commands: (n, 5), columns q*, dq*, kp, kd, tau in motor coordinates: rad, rad/s, Nm/rad, Nm s/rad, Nm.
            instead: motor index -> special command sent in place of the MIT command; motors reply alike to both.

        Raises:
            ActionError: `commands` has the wrong shape or a non-finite value; nothing was sent.
            BusError: the channel is lost or its transmit queue is full.
        """
        count = len(self.motors)
        if commands.shape != (count, 5):
            raise ActionError(f"{self.channel}: commands have shape {commands.shape}, not ({count}, 5)")
        rows = commands.tolist()
        if not math.isfinite(commands.sum()):
            for spec, row in zip(self.motors, rows, strict=True):
                encode_mit(spec.type, *row)  # raises ActionError, which names the value
        encoded = [pack_mit(ranges, *row) for ranges, row in zip(self._ranges, rows, strict=True)]
        for index in self._turning:
            encoded[index] = encode_velocity(rows[index][1])
        for message, data in zip(self._messages, encoded, strict=False):  # the last message may be the handle's
            message.data = data
        messages = self._messages
        if instead:
            messages = [*messages]
            for index, command in instead.items():
                messages[index] = data_message(self.motors[index].can_id, command.value)
        self.drain()
        absent = [i for i in self._requests.absent() if i not in instead]  # DISABLE must not be delayed
        if absent:  # the rare case
            messages = [message for i, message in enumerate(messages) if i not in absent]
        self._begin([i for i in range(count) if i not in absent], handle=self.encoder is not None)
        try:
            self._port.send(messages)
        except BusError:
            self._requests.withdraw()
            raise

    def collect(self, deadline_s: float) -> bool:
        """Process replies to the last `send`; wait for missing ones until `deadline_s` (the chain's clock).

        Return whether every motor replied. Replies that arrive later are processed in a later tick.

        Raises:
            BusError: the channel is lost.
        """
        silent = self._close(deadline_s)
        self.all_answered = not silent and self._requests.newest.asked == len(self.motors)
        if not self.all_answered or any_of(self.missed > 0):
            self.missed = np.where([i in self._requests.heard for i in range(len(self.motors))], 0, self.missed + 1)
        lost = sum(self._requests.lost)
        if lost != self._lost_before:
            self._lost_before = lost
            self.round_trip.doubt()
        self._publish()
        return self.all_answered

    def special(
        self, command: SpecialCommand, timeout_s: float = 0.05, motors: Sequence[int] | None = None
    ) -> list[bool]:
        """Send a special command to the motors with these indices (default: all).

        ZERO moves the origin of positions, so the next readings are accepted however far off they are.

        Returns:
            Per motor of the chain, whether it replied within `timeout_s`.
        """
        if command is SpecialCommand.ZERO:
            self.feedback.restart()
        repeats = CLEAR_REPEATS if command is SpecialCommand.CLEAR else 1
        chosen = range(len(self.motors)) if motors is None else motors
        self._settle()
        self._begin(chosen, repeats=repeats).paced = True
        for spec in (self.motors[i] for i in chosen):
            if command is SpecialCommand.ENABLE:
                self.clock.sleep(ENABLE_PAUSE_S)
            self._port.send([data_message(spec.can_id, command.value)] * repeats)
            if command is SpecialCommand.CLEAR:
                self.clock.sleep(_CLEAR_PAUSE_S)
        return self._answered(timeout_s)

    def refresh(self, timeout_s: float = 0.05) -> list[bool]:
        """Request feedback from all motors without commanding motion. Return, per motor, whether it replied."""
        self._settle()
        self._begin(range(len(self.motors)))
        self._port.send([data_message(REGISTER_ID, encode_refresh(spec.can_id)) for spec in self.motors])
        return self._answered(timeout_s)

    def read_register(
        self, motor: int, register: int, timeout_s: float = 0.05, attempts: int = _REGISTER_ATTEMPTS
    ) -> float | int:
        """Read a register of the motor with index `motor`. Blocks until the reply, so not for use in the loop.

        Raises:
            MotorError: the motor replied to no attempt.
            ConfigError: there is no such register.
        """
        spec = self.motors[motor]
        payload = encode_read(spec.can_id, register)
        header = payload[:4]  # motor id, opcode and register, which a reply repeats
        for _ in range(attempts):
            data = self._ask(spec, payload, timeout_s, lambda data: len(data) == 8 and data[:4] == header)
            if data is not None:
                return decode_value(register, data[4:])
            self._receiver.late_registers += 1
        raise MotorError(
            f"{self.channel}: motor {spec.name} (id {spec.can_id}) did not answer reading register "
            f"{REGISTERS[register].name}; check its power and cable"
        )

    def _ask(self, spec: MotorSpec, payload: bytes, timeout_s: float, answers: Callable[[bytes], bool]) -> bytes | None:
        """Send a request; return the data of the motor's first frame for which `answers` is true, None on timeout."""
        self.drain()
        self._port.send([data_message(REGISTER_ID, payload)])
        for message in self._receiver.frames(self.clock.now() + timeout_s):
            if message.arbitration_id == spec.feedback_id and is_classic_data(message):
                data = bytes(message.data)
                if answers(data):
                    return data
            self._receiver.accept(message)
        return None

    def _begin(self, motors: Iterable[int], handle: bool = False, repeats: int = 1) -> Request:
        """Register a request that is about to be sent. The caller must have processed all frames received so far."""
        self._port.synchronise()
        request = self._requests.begin(motors, handle, repeats)
        request.sent_s = self.clock.now()
        return request

    def _settle(self) -> None:
        """Wait for replies to earlier requests, at most the longest round trip, so that none counts for the next one.

        Until a first reply has been received, no reply is given up: the round-trip time is still unknown.
        """
        self.drain()
        longest_s = self.round_trip.longest_s
        if not self._requests.owed or not longest_s:
            return
        for message in self._receiver.frames(self._requests.newest.sent_s + longest_s):
            self._receiver.accept(message)
            if not self._requests.owed:
                break
        self._requests.forget()

    def _close(self, deadline_s: float) -> set[int]:
        """Wait for the replies to the newest request; return the indices of motors that have not replied."""
        request = self._requests.newest
        self._receiver.take_answers(request, deadline_s)
        if self._requests.give_up_handle() and self.encoder is not None:
            self.encoder.lost += 1
        return request.motors

    def _answered(self, timeout_s: float) -> list[bool]:
        silent = self._close(self.clock.now() + timeout_s + 2.0 * self.round_trip.one_way_s)
        self._publish()
        return [i not in silent for i in range(len(self.motors))]

    def _publish(self) -> None:
        self._requests.heard.clear()
        self.feedback.publish()
        if self._receiver.trial is not None:
            self._receiver.trial.publish()
