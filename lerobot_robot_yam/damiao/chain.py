"""All motors of one CAN bus: send every command, then collect every reply, by identifier.

A late or lost reply ages its own motor only and is never taken for another's. What has arrived is drained before
the next tick is sent, so old data cannot pile up in the socket.

`collect` ends a tick. Who would not leave the wire idle for a moment calls `await_all_but_one` instead, sends the next
commands while the last reply is on the wire, and takes that one, which comes before all others, with `collect_earlier`.
"""

from collections.abc import Iterable, Iterator, Sequence

import can
import numpy as np

from lerobot_robot_yam.damiao.bus_port import BusPort, data_message, is_classic_data
from lerobot_robot_yam.damiao.codec import SpecialCommand, encode_mit
from lerobot_robot_yam.damiao.encoder import (
    EVENT_ID,
    HANDLE_IDS,
    REPORT_ID,
    REQUEST_ID,
    HandleEncoder,
    encode_report_request,
)
from lerobot_robot_yam.damiao.feedback import FeedbackStore
from lerobot_robot_yam.damiao.motor_spec import MotorSpec, check_specs
from lerobot_robot_yam.damiao.registers import (
    Opcode,
    decode_reply,
    encode_read,
    encode_refresh,
    encode_store,
    encode_write,
    register_row,
)
from lerobot_robot_yam.damiao.requests import Request, Requests
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S, REGISTER_ID
from lerobot_robot_yam.errors import ActionError, MotorError

ENABLE_PAUSE_S = 0.003  # the vendor's driver leaves this much time before each enable
CLEAR_REPEATS = 3  # and sends "clear error" this many times
_NO_STATE = 0x10  # first bytes below carry no state: feedback of a disabled motor, or a register's answer
# Of the reply that is on the wire when the next commands are sent: less than the first answer to those can take, which
# is two frames of 111 bits, the shortest with 8 bytes.
LAST_REPLY_S = 1.7 * FRAME_TIME_S


class MotorChain(FeedbackStore):
    """All motors (and optionally the handle encoder) on one CAN bus. One thread touches it.

    State, refreshed as new arrays by every `collect` (`lost` where it grows), in motor coordinates, shape (n,):
        position_rad (multi-turn: unwrapped from the first reading), velocity_rad_s, torque_nm,
        temp_mos_c, temp_rotor_c, stamp_s (the clock's time of arrival, -inf before the first reply),
        fault (int, see `tables.Fault`), lost (int, replies that missed their tick, in total).
    In short: `all_answered` (the last `send` that was collected) and `all_normal` (no fault, all enabled).

    Counters: `duplicates` (answers beyond those asked for, the mark of two motors with one id),
    `foreign_commands` (frames that another driver sent to our motors), `foreign` (identifier -> count of
    frames that belong to nothing here), `error_frames`.
    """

    def __init__(
        self,
        bus: can.BusABC,
        motors: Sequence[MotorSpec],
        *,
        channel: str,
        encoder: HandleEncoder | None = None,
    ):
        """
        Raises:
            ConfigError: names or identifiers are not unique, or a type is unknown.
        """
        self.channel = channel
        check_specs(motors, channel)
        self.motors = tuple(motors)
        self.encoder = encoder
        self._port = BusPort(bus, channel)
        self.clock = self._port.clock
        count = len(self.motors)
        self._index = {spec.answer_key: i for i, spec in enumerate(self.motors)}
        self._command_ids = frozenset(spec.can_id for spec in self.motors)
        # Reused every tick; a bus copies what it queues.
        self._messages = [data_message(spec.can_id, bytes(8)) for spec in self.motors]
        if encoder is not None:
            self._messages.append(data_message(REQUEST_ID, encode_report_request()))

        self.lost: np.ndarray = np.zeros(count, dtype=int)
        self._requests = Requests(count)
        self._late_registers = 0  # register replies that were given up on and may still come
        self.all_answered = False
        self.foreign_commands = 0
        self.foreign: dict[int, int] = {}
        self.error_frames = 0
        super().__init__([spec.type for spec in self.motors])

    def __len__(self) -> int:
        return len(self.motors)

    @property
    def expected_wire_s(self) -> float:
        """Time one exchange occupies the wire: two frames per motor, and the handle's two."""
        return 2 * len(self._messages) * FRAME_TIME_S

    @property
    def duplicates(self) -> np.ndarray:
        """(n,) answers beyond those asked for."""
        return np.array(self._requests.duplicates)

    def age_s(self, now: float) -> np.ndarray:
        """(n,) seconds from each motor's newest answer to `now` (the clock's time); inf if none came."""
        return now - self.stamp_s

    def pack(self, commands: np.ndarray) -> list[bytes]:
        """Data of one MIT command frame per motor. Sends nothing.

        Args:
            commands: (n, 5), columns q*, dq*, kp, kd, tau in motor coordinates: rad, rad/s, Nm/rad,
                Nm s/rad, Nm.

        Raises:
            ActionError: wrong shape or a non-finite value.
        """
        count = len(self.motors)
        if commands.shape != (count, 5):
            raise ActionError(f"{self.channel}: commands have shape {commands.shape}, not ({count}, 5)")
        return [encode_mit(kind, *row) for kind, row in zip(self._types, commands.tolist(), strict=True)]

    def send(self, commands: np.ndarray) -> None:
        """`pack` and `send_packed`."""
        self.send_packed(self.pack(commands))

    def send_packed(self, packed: Sequence[bytes]) -> None:
        """Send what `pack` has made, then the handle's request, without waiting for anything.

        Raises:
            BusError: the channel is gone or its transmit queue is full.
        """
        count = len(self.motors)
        for message, data in zip(self._messages[:count], packed, strict=True):
            message.data = data
        self._begin(range(count), handle=self.encoder is not None)
        self._port.send(self._messages)
        self._requests.open[-1].sent_s = self.clock.now()

    def collect(self, deadline_s: float) -> bool:
        """Take the replies to the last `send`; block until `deadline_s` (the clock's time) only for stragglers.

        Returns whether every motor answered; each that did not counts as lost.

        Raises:
            BusError: the channel is gone.
        """
        complete = True
        while self._requests.open:
            complete = self._collect_oldest(deadline_s)
        self.publish()
        return complete

    def await_all_but_one(self, deadline_s: float) -> None:
        """Take replies to the last `send` until only one is missing: that is on the wire, the next commands may follow.

        Not earlier: they would go before replies that wait for the wire, as their identifiers are lower. Where a handle
        is asked, which may confuse questions that overlap, everything is collected. So it is when a reply has been lost
        or come twice, and then the wire is left alone until `deadline_s` (the clock's time): from then on answers would
        be taken for those to another question.

        Raises:
            BusError: the channel is gone.
        """
        requests = self._requests
        if self.encoder is not None:
            self.collect(deadline_s)
        elif requests.in_step:
            requests.ahead = True
            if requests.open:
                self._take_answers(requests.open[-1], deadline_s, missing=1)
        else:
            self.clock.sleep(max(0.0, deadline_s - self.clock.now()))
            requests.in_step = True
            self.collect(deadline_s)

    def collect_earlier(self) -> bool:
        """As `collect`, for the `send` before the last where that was sent ahead; it waits for the end of a reply."""
        complete, requests = True, self._requests
        while len(requests.open) > 1:
            complete = self._collect_oldest(requests.open[-1].sent_s + LAST_REPLY_S)
        self.publish()
        return complete

    def exchange(self, commands: np.ndarray, timeout_s: float | None = None) -> bool:
        """`send`, sleep until the wire should be through, `collect`. Two wake-ups when nothing is late.

        Args:
            commands: (n, 5) as for `send`.
            timeout_s: from the send on; default is the expected wire time + 2 ms.
        """
        self.send(commands)
        sent_s = self.clock.now()
        self.clock.sleep(self.expected_wire_s)
        return self.collect(sent_s + (self.expected_wire_s + 0.002 if timeout_s is None else timeout_s))

    def special(
        self, command: SpecialCommand, timeout_s: float = 0.05, motors: Sequence[int] | None = None
    ) -> list[bool]:
        """Send a special command to motors (by index; default all), and say who of all answered within `timeout_s`.

        What the last `send` still waits for is collected first.

        ENABLE makes motors obey; ZERO moves their origin, so multi-turn counting starts anew.
        """
        if command is SpecialCommand.ZERO:
            self.restart_turns()
        repeats = CLEAR_REPEATS if command is SpecialCommand.CLEAR else 1
        chosen = range(len(self.motors)) if motors is None else motors
        self._settle()
        self._begin(chosen, repeats=repeats)
        for spec in (self.motors[i] for i in chosen):
            if command is SpecialCommand.ENABLE:
                self.clock.sleep(ENABLE_PAUSE_S)
            self._port.send([data_message(spec.can_id, command.value)] * repeats)
        return self._answered(timeout_s)

    def refresh(self, timeout_s: float = 0.05) -> list[bool]:
        """Ask all motors for feedback; commands no motion. Returns, per motor, whether it answered."""
        self._settle()
        self._begin(range(len(self.motors)))
        self._port.send([data_message(REGISTER_ID, encode_refresh(spec.can_id)) for spec in self.motors])
        return self._answered(timeout_s)

    def drain(self) -> None:
        """Take everything that has already arrived, without waiting."""
        while (message := self._port.recv(0.0)) is not None:
            self._receive(message)

    def read_register(self, motor: int, register: int, timeout_s: float = 0.05, attempts: int = 3) -> float | int:
        """Value of a register of motor number `motor` (index). Blocks: not for use inside the loop.

        Raises:
            MotorError: no answer to any attempt.
            ConfigError: there is no such register.
        """
        payload = encode_read(self.motors[motor].can_id, register)
        return self._ask_register(motor, Opcode.READ, register, payload, timeout_s, attempts)

    def write_register(
        self, motor: int, register: int, value: float, timeout_s: float = 0.05, attempts: int = 3
    ) -> float | int:
        """Set a register in RAM (see `store_registers`) and return the value the motor now holds.

        Raises:
            MotorError: no answer to any attempt.
            ConfigError: unknown or read-only register, or a value it cannot hold.
        """
        payload = encode_write(self.motors[motor].can_id, register, value)
        return self._ask_register(motor, Opcode.WRITE, register, payload, timeout_s, attempts)

    def store_registers(self, motor: int, timeout_s: float = 0.2) -> None:
        """Store the registers of a motor to flash; disable it first.

        The content of the answer is not documented, so any frame of that motor confirms.

        Raises:
            MotorError: no answer.
        """
        spec = self.motors[motor]
        self.drain()
        self._port.send([data_message(REGISTER_ID, encode_store(spec.can_id))])
        for message in self._until(self.clock.now() + timeout_s):
            if message.arbitration_id == spec.feedback_id and is_classic_data(message):
                return
            self._receive(message)
        raise MotorError(
            f"{self.channel}: motor {spec.name} (id {spec.can_id}) did not confirm storing its registers; "
            "check its power and read them back"
        )

    def _ask_register(
        self, motor: int, opcode: int, register: int, payload: bytes, timeout_s: float, attempts: int
    ) -> float | int:
        spec = self.motors[motor]
        for _ in range(attempts):
            self.drain()
            self._port.send([data_message(REGISTER_ID, payload)])
            for message in self._until(self.clock.now() + timeout_s):
                if message.arbitration_id == spec.feedback_id and is_classic_data(message):
                    reply = decode_reply(bytes(message.data))
                    if reply is not None and reply[:3] == (spec.can_id, opcode, register):
                        return reply.value
                self._receive(message)
            self._late_registers += 1
        verb = "reading" if opcode == Opcode.READ else "writing"
        raise MotorError(
            f"{self.channel}: motor {spec.name} (id {spec.can_id}) did not answer {verb} register "
            f"{register_row(register).name}; check its power and cable"
        )

    def _until(self, deadline_s: float) -> Iterator[can.Message]:
        """Frames as they arrive, until the deadline."""
        while (remaining := deadline_s - self.clock.now()) > 0.0:
            message = self._port.recv(remaining)
            if message is not None:
                yield message

    def _begin(self, motors: Iterable[int], handle: bool = False, repeats: int = 1) -> None:
        """Open a request: what has arrived until now belongs to earlier ones."""
        if not self._requests.ahead:  # else they are still open, and answers come in order
            self.drain()
        self._port.synchronise()
        self._requests.begin(motors, handle, repeats)

    def _settle(self) -> None:
        """Collect what is open: answers to commands are none to what follows them."""
        self._requests.ahead = False
        if self._requests.open:
            self.collect(self.clock.now() + 2 * self.expected_wire_s)

    def _take_answers(self, request: Request, deadline_s: float, missing: int = 0) -> None:
        """Take frames until at most so many of a request's answers are missing."""
        while request.missing > missing:
            remaining_s = deadline_s - self.clock.now()
            message = self._port.recv(max(0.0, remaining_s))
            if message is not None:
                self._receive(message)
            elif remaining_s <= 0.0:  # not before: who sleeps past the deadline finds all that has come meanwhile
                return

    def _collect_oldest(self, deadline_s: float) -> bool:
        silent = self._close(deadline_s)
        if silent:
            self.lost = self.lost.copy()  # others keep what they have been given
            self.lost[list(silent)] += 1
        self.all_answered = not silent
        return self.all_answered

    def _close(self, deadline_s: float) -> set[int]:
        """Close the oldest request; returns the motors that have not answered it."""
        self._take_answers(self._requests.open[0], deadline_s)
        request = self._requests.close()
        if request.handle and self.encoder is not None:
            self.encoder.lost += 1
        return request.motors

    def _answered(self, timeout_s: float) -> list[bool]:
        silent = self._close(self.clock.now() + timeout_s)
        self.publish()
        return [i not in silent for i in range(len(self.motors))]

    def _receive(self, message: can.Message) -> None:
        """Put one frame where it belongs. Hot: once per frame."""
        if message.is_error_frame:
            self.error_frames += 1
            return
        data, index = message.data, None
        if len(data) == 8 and not message.is_extended_id:  # a remote frame has no data
            index = self._index.get(message.arbitration_id << 4 | data[0] & 0xF)
        if index is None:
            self._receive_other(message)
            return
        if data[0] < _NO_STATE and decode_reply(bytes(data)) is not None:
            # As feedback it would put the motor at -12.5 rad or turn it once. Nobody's joint comes below -11.7 rad.
            if self._late_registers:
                self._late_registers -= 1
            else:
                self._note_foreign(message.arbitration_id)
            return
        self.take(index, data, self._port.arrival_s(message))
        self._requests.answer(index)

    def _receive_other(self, message: can.Message) -> None:
        can_id, ours = message.arbitration_id, is_classic_data(message)
        if ours and self.encoder is not None and can_id in HANDLE_IDS:
            if can_id in (REPORT_ID, EVENT_ID):
                taken = self.encoder.accept(message.data, self._port.arrival_s(message))
                if taken and can_id == REPORT_ID:
                    self._requests.handle_answer()
            return
        if ours and can_id in self._command_ids:
            self.foreign_commands += 1
        self._note_foreign(can_id)

    def _note_foreign(self, can_id: int) -> None:
        self.foreign[can_id] = self.foreign.get(can_id, 0) + 1
