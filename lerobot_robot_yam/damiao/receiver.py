"""Receiver of a motor channel: assigns each arriving frame to its motor and request, whenever the frame arrives.

Replies are distinguished by CAN id: a late or lost reply only makes its own motor's state older. `requests` matches
replies to commands, and `round_trip` estimates when the motor took the sample. The newest feedback of every motor is
decoded, checked for plausibility and timestamped.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import can
import numpy as np

from lerobot_robot_yam.damiao.bus_port import BusPort, is_classic_data
from lerobot_robot_yam.damiao.codec import ranges_of, unpack_feedback
from lerobot_robot_yam.damiao.handle_encoder import EVENT_ID, HANDLE_IDS, REPORT_ID, HandleEncoder
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.plausibility import PERIOD_S, Plausibility
from lerobot_robot_yam.damiao.registers import decode_reply
from lerobot_robot_yam.damiao.reply_matching import Request, Requests
from lerobot_robot_yam.damiao.round_trip import RoundTrip
from lerobot_robot_yam.damiao.tables import Fault, motor_type

_NO_STATE = 0x10  # first data bytes below this contain no state: feedback of a disabled motor, or a register reply
# Position, velocity, torque, two temperatures, time of sampling, time of the request, doubt about the time of sampling.
_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, -math.inf, -math.inf, 0.0)


class FeedbackStore:
    """Newest feedback per motor, in motor coordinates.

    `take` works on tuples, since storing one float into an array costs more than decoding the frame.
    `publish` converts the tuples to new arrays of shape (n,), so that a reader may keep them.

    Args:
        types: types of the motors.
        turns: per motor, whether it may rotate beyond the position range of the frames, so that readings are unwrapped.
        period_s: period of the control loop, s.

    Attributes:
        position_rad, velocity_rad_s, torque_nm: state; positions of motors with `turns` are unwrapped.
        temp_mos_c, temp_rotor_c: temperatures of power stage and coil, °C.
        stamp_s: when the motor sampled its state (the chain's clock), -inf before the first reply.
        asked_s: when the command was sent to which the state is the reply.
        doubt_s: time by which the sample may be newer than `stamp_s`, s: 0 unless the adapter has become slower.
        fault: fault code, see `tables.Fault`.
        distrusted: whether the motor's readings are implausible and no longer used.
        all_normal: whether all motors are enabled, trusted and without a fault.
    """

    def __init__(self, types: Sequence[str], turns: Sequence[bool], period_s: float = PERIOD_S):
        self._ranges = [ranges_of(name) for name in types]
        rows = [motor_type(name) for name in types]
        # Half of the range at which positions in frames wrap around.
        self._half = [row.position_max_rad if turning else math.inf for row, turning in zip(rows, turns, strict=True)]
        self._judge = Plausibility(rows, turns, period_s)
        count = len(rows)
        self._newest = [_NOTHING] * count
        self._fault: list[int] = [Fault.DISABLED] * count
        self._normal: list[int] = [Fault.NORMAL] * count
        self._turn_rad = [0.0] * count
        self._fresh = [True] * count  # whether the next reading starts unwrapping anew
        self.publish()

    def take(
        self, index: int, data: bytes, asked_s: float, sampled_s: float, latest_s: float, arrived_s: float
    ) -> None:
        """Decode a feedback frame (8 bytes) of motor number `index`; use it if it is plausible. Hot: once per frame.

        A motor with `turns` is assumed to have turned the shorter way round between two readings; its first reading is
        not unwrapped.

        Args:
            asked_s, arrived_s: when the command was sent to which the frame is the reply, and when the frame arrived.
            sampled_s, latest_s: most likely and latest time at which the motor sampled its state.
        """
        _, fault, position, velocity, torque, mos, rotor = unpack_feedback(self._ranges[index], data)
        turn, half = self._turn_rad[index], self._half[index]
        position += turn
        if not self._fresh[index]:
            step = position - self._newest[index][0]
            if step > half:
                turn -= 2.0 * half
                position -= 2.0 * half
            elif step < -half:
                turn += 2.0 * half
                position += 2.0 * half
        judge = self._judge
        if not judge.accept(index, position, velocity, sampled_s, latest_s, asked_s, arrived_s):
            if judge.distrusted[index] and judge.crept[index]:  # the motor is where it was before its reading crept
                row = self._newest[index]
                self._newest[index], judge.crept[index] = (row[0] - judge.crept[index], *row[1:]), 0.0
            return
        self._fresh[index], self._turn_rad[index], self._fault[index] = False, turn, fault
        self._newest[index] = (position, velocity, torque, mos, rotor, sampled_s, asked_s, latest_s - sampled_s)

    def assume(self, position_rad: np.ndarray, velocity_rad_s: np.ndarray, sampled_s: np.ndarray) -> None:
        """Assume the positions that motors had at their last known samples, (n,) in motor coordinates.

        These positions are the motors' state until they reply. Their first readings are compared with them, and count
        the turns from there.
        """
        rows = zip(position_rad.tolist(), velocity_rad_s.tolist(), sampled_s.tolist(), strict=True)
        for index, (q, dq, at_s) in enumerate(rows):
            if math.isfinite(at_s):
                self._judge.assume(index, q, dq, at_s)
                if math.isfinite(half := self._half[index]):
                    self._turn_rad[index], self._fresh[index] = 2.0 * half * round(q / (2.0 * half)), False
            row = self._newest[index]
            if row[5] == -math.inf:  # never sampled
                self._newest[index] = (q, *row[1:])
        self.publish()

    def restart(self, motors: Iterable[int] | None = None) -> None:
        """Accept the next reading of these motors (default: all) without a check, and restart unwrapping."""
        chosen = range(len(self._ranges)) if motors is None else list(motors)
        self._judge.restart(chosen)
        for index in chosen:
            self._turn_rad[index], self._fresh[index] = 0.0, True

    def believe(self, motors: Iterable[int]) -> None:
        """Accept the next readings of these motors without a check: limp joints may have been moved."""
        self._judge.restart(motors)

    def distrust(self, motors: Sequence[int], position_rad: np.ndarray) -> None:
        """Reject all readings of these motors until `restart`; set their positions from position_rad (all n motors)."""
        self._judge.distrust(motors)
        for index in motors:
            self._newest[index] = (float(position_rad[index]), 0.0, *self._newest[index][2:])
        self.publish()

    def adopt(self, other: "FeedbackStore", motors: Iterable[int]) -> None:
        """Copy the state of these motors from another store, and compare their next readings with it."""
        chosen = list(motors)
        self.restart(chosen)
        for i in chosen:
            self._newest[i], self._fault[i] = other._newest[i], other._fault[i]
            self._turn_rad[i], self._fresh[i] = other._turn_rad[i], other._fresh[i]
            position, velocity, _, _, _, sampled_s, *_ = other._newest[i]
            self._judge.assume(i, position, velocity, sampled_s)
        self.publish()

    @property
    def rejected(self) -> np.ndarray:
        """Number of implausible readings so far, per motor, (n,)."""
        return np.array(self._judge.rejected)

    def publish(self) -> None:
        """Copy the newest state to the arrays."""
        state = np.array(self._newest).reshape(-1, len(_NOTHING)).T.copy()
        self.position_rad, self.velocity_rad_s, self.torque_nm = state[0], state[1], state[2]
        self.temp_mos_c, self.temp_rotor_c, self.stamp_s, self.asked_s = state[3], state[4], state[5], state[6]
        self.doubt_s = state[7]
        self.fault = np.array(self._fault)
        self.distrusted = np.array(self._judge.distrusted)
        self.all_normal = self._fault == self._normal and not any(self._judge.distrusted)


class Receiver:
    """Receiving half of a `chain.MotorChain`, whose documentation covers the counters.

    Attributes:
        feedback: newest feedback of the motors.
        trial: second store that gets the same frames, or None.
        requests: open requests.
        round_trip: delays of the adapter.
        late_registers: number of register replies that timed out and may still arrive.
    """

    def __init__(
        self, port: BusPort, motors: Sequence[MotorSpec], encoder: HandleEncoder | None, period_s: float = PERIOD_S
    ):
        self._port, self._encoder, self._period_s = port, encoder, period_s
        self._index = {spec.answer_key: i for i, spec in enumerate(motors)}
        self._command_ids = frozenset(identifier for spec in motors for identifier in (spec.can_id, spec.command_id))
        self._motors = motors
        self.feedback = self.new_store()
        self.trial: FeedbackStore | None = None
        self.requests = Requests(len(motors))
        self.round_trip = RoundTrip()
        self.late_registers = 0
        self.foreign_commands = 0
        self.foreign: Counter[int] = Counter()
        self.error_frames = 0

    def new_store(self) -> FeedbackStore:
        """Create a store for these motors, without any state."""
        motors = self._motors
        return FeedbackStore([spec.type for spec in motors], [spec.turns for spec in motors], self._period_s)

    def drain(self) -> None:
        """Process all frames that have already arrived, without waiting."""
        while (message := self._port.recv(0.0)) is not None:
            self.accept(message)

    def take_answers(self, request: Request, deadline_s: float) -> None:
        """Process frames until all replies to a request have arrived, or until `deadline_s` (the chain's clock)."""
        clock = self._port.clock
        while request.missing:
            remaining_s = deadline_s - clock.now()
            message = self._port.recv(max(0.0, remaining_s))
            if message is not None:
                self.accept(message)
            elif remaining_s <= 0.0:  # checked last: a caller that slept past the deadline still gets all frames
                return

    def frames(self, deadline_s: float) -> Iterator[can.Message]:
        """Yield frames as they arrive, until `deadline_s` (the chain's clock); the caller passes them to `accept`."""
        clock = self._port.clock
        while (remaining_s := deadline_s - clock.now()) > 0.0:
            message = self._port.recv(remaining_s)
            if message is not None:
                yield message

    def accept(self, message: can.Message) -> None:
        """Process one frame. Hot: once per frame."""
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
            # Decoded as feedback, such a frame would mean -12.5 rad, or one more turn. Joints stay above -11.7 rad.
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
        if self.trial is not None:
            self.trial.take(index, data, sent_s, sampled_s, latest_s, arrived_s)

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
