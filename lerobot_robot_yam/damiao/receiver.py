"""Everything that arrives on a channel of motors: each frame goes where it belongs, whenever it comes.

Answers are told apart by identifier: a late or lost one ages its own motor and is never taken for another's.
`requests` finds out which command each answer belongs to, and `round_trip` when its sample was taken.
"""

from collections import Counter
from collections.abc import Iterator, Sequence

import can

from lerobot_robot_yam.damiao.bus_port import BusPort, is_classic_data
from lerobot_robot_yam.damiao.feedback import FeedbackStore
from lerobot_robot_yam.damiao.handle_encoder import EVENT_ID, HANDLE_IDS, REPORT_ID, HandleEncoder
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import decode_reply
from lerobot_robot_yam.damiao.reply_matching import Request, Requests
from lerobot_robot_yam.damiao.round_trip import RoundTrip

_NO_STATE = 0x10  # first bytes below carry no state: feedback of a disabled motor, or a register's answer


class Receiver:
    """The receiving half of a `chain.MotorChain`; see there for the counters.

    Attributes:
        feedback: newest feedback of the motors.
        requests: questions that are open.
        round_trip: how long the adapter takes.
        late_registers: register replies that were given up on and may still come.
    """

    def __init__(self, port: BusPort, motors: Sequence[MotorSpec], encoder: HandleEncoder | None):
        self._port, self._encoder = port, encoder
        self._index = {spec.answer_key: i for i, spec in enumerate(motors)}
        self._command_ids = frozenset(spec.can_id for spec in motors)
        self.feedback = FeedbackStore([spec.type for spec in motors], [spec.turns for spec in motors])
        self.requests = Requests(len(motors))
        self.round_trip = RoundTrip()
        self.late_registers = 0
        self.foreign_commands = 0
        self.foreign: Counter[int] = Counter()
        self.error_frames = 0

    def drain(self) -> None:
        """Take everything that has already arrived, without waiting."""
        while (message := self._port.recv(0.0)) is not None:
            self.accept(message)

    def take_answers(self, request: Request, deadline_s: float) -> None:
        """Take frames until all answers to a request have come, or until `deadline_s` (the clock's time)."""
        clock = self._port.clock
        while request.missing:
            remaining_s = deadline_s - clock.now()
            message = self._port.recv(max(0.0, remaining_s))
            if message is not None:
                self.accept(message)
            elif remaining_s <= 0.0:  # not before: a caller that sleeps past the deadline still finds all that has come
                return

    def frames(self, deadline_s: float) -> Iterator[can.Message]:
        """Frames as they arrive, until `deadline_s` (the clock's time); the caller hands them to `accept`."""
        clock = self._port.clock
        while (remaining_s := deadline_s - clock.now()) > 0.0:
            message = self._port.recv(remaining_s)
            if message is not None:
                yield message

    def accept(self, message: can.Message) -> None:
        """Put one frame where it belongs. Hot: once per frame."""
        if message.is_error_frame:
            self.error_frames += 1
            return
        data, index = message.data, None
        if len(data) == 8 and not message.is_extended_id:  # a remote frame has no data
            index = self._index.get(message.arbitration_id << 4 | data[0] & 0xF)
        if index is None:
            self._accept_other(message)
            return
        if data[0] < _NO_STATE and decode_reply(bytes(data)) is not None:
            # As feedback it would put the motor at -12.5 rad or turn it once. No joint comes below -11.7 rad.
            if self.late_registers:
                self.late_registers -= 1
            else:
                self.foreign[message.arbitration_id] += 1
            return
        request = self.requests.answer(index)
        if request is None:
            return
        sent_s = request.sent_s
        arrived_s = self._port.arrival_s(message)
        sampled_s, latest_s = self.round_trip.sampled_s(sent_s, arrived_s, index, request.asked, request.paced)
        self.feedback.take(index, data, sent_s, sampled_s, latest_s, arrived_s)

    def _accept_other(self, message: can.Message) -> None:
        can_id, ours = message.arbitration_id, is_classic_data(message)
        if ours and self._encoder is not None and can_id in HANDLE_IDS:
            if can_id in (REPORT_ID, EVENT_ID):
                taken = self._encoder.accept(message.data, self._port.arrival_s(message))
                if taken and can_id == REPORT_ID:
                    self.requests.handle_answer()
            return
        if ours and can_id in self._command_ids:
            self.foreign_commands += 1
        self.foreign[can_id] += 1
