"""What arrives on a channel of motors: every frame goes where it belongs, whenever it comes.

Answers are told apart by identifier: a late or lost one ages its own motor and is never taken for another's. Which
command each belongs to is found out by `requests`, and when its sample was taken by `round_trip`.
"""

from collections.abc import Iterator, Sequence

import can
import numpy as np

from lerobot_robot_yam.damiao.bus_port import BusPort, is_classic_data
from lerobot_robot_yam.damiao.encoder import EVENT_ID, HANDLE_IDS, REPORT_ID, HandleEncoder
from lerobot_robot_yam.damiao.feedback import FeedbackStore
from lerobot_robot_yam.damiao.motor_spec import MotorSpec, check_specs
from lerobot_robot_yam.damiao.registers import decode_reply
from lerobot_robot_yam.damiao.requests import Request, Requests
from lerobot_robot_yam.damiao.round_trip import RoundTrip

_NO_STATE = 0x10  # first bytes below carry no state: feedback of a disabled motor, or a register's answer


class Receiver(FeedbackStore):
    """The receiving half of a `chain.MotorChain`; see there for arguments, state and counters."""

    def __init__(self, bus: can.BusABC, motors: Sequence[MotorSpec], channel: str, encoder: HandleEncoder | None):
        self.channel = channel
        check_specs(motors, channel)
        self.motors = tuple(motors)
        self.encoder = encoder
        self._port = BusPort(bus, channel)
        self.clock = self._port.clock
        self._index = {spec.answer_key: i for i, spec in enumerate(self.motors)}
        self._command_ids = frozenset(spec.can_id for spec in self.motors)
        self._requests = Requests(len(self.motors))
        self.round_trip = RoundTrip()
        self._late_registers = 0  # register replies that were given up on and may still come
        self.foreign_commands = 0
        self.foreign: dict[int, int] = {}
        self.error_frames = 0
        super().__init__([spec.type for spec in self.motors], [spec.turns for spec in self.motors])

    def __len__(self) -> int:
        return len(self.motors)

    @property
    def duplicates(self) -> np.ndarray:
        """(n,) answers to no question; their contents are not used, since nobody knows how old they are."""
        return np.array(self._requests.duplicates)

    @property
    def lost(self) -> np.ndarray:
        """(n,) answers that never came."""
        return np.array(self._requests.lost)

    def age_s(self, now: float) -> np.ndarray:
        """(n,) seconds from the command that each motor has answered last to `now` (the clock's time); inf if none."""
        return now - self.asked_s

    def silence_s(self, now: float) -> np.ndarray:
        """(n,) seconds for which nothing was heard of each motor, beyond what its adapter takes anyway."""
        return now - self.stamp_s - 2.0 * self.round_trip.one_way_s

    def drain(self) -> None:
        """Take everything that has already arrived, without waiting."""
        while (message := self._port.recv(0.0)) is not None:
            self._receive(message)

    def _take_answers(self, request: Request, deadline_s: float) -> None:
        """Take frames until all of a request's answers have come."""
        while request.missing:
            remaining_s = deadline_s - self.clock.now()
            message = self._port.recv(max(0.0, remaining_s))
            if message is not None:
                self._receive(message)
            elif remaining_s <= 0.0:  # not before: who sleeps past the deadline finds all that has come meanwhile
                return

    def _until(self, deadline_s: float) -> Iterator[can.Message]:
        """Frames as they arrive, until the deadline."""
        while (remaining := deadline_s - self.clock.now()) > 0.0:
            message = self._port.recv(remaining)
            if message is not None:
                yield message

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
        request = self._requests.answer(index)
        if request is None:
            return
        sent_s = request.sent_s
        arrived_s = self._port.arrival_s(message)
        sampled_s, latest_s = self.round_trip.sampled_s(sent_s, arrived_s, index, request.asked, request.paced)
        self.take(index, data, sent_s, sampled_s, latest_s, arrived_s)

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
