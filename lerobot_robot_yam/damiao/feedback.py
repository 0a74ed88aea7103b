"""The newest feedback of every motor of a chain: decoded, judged, stamped."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from lerobot_robot_yam.damiao.codec import ranges_of, unpack_feedback
from lerobot_robot_yam.damiao.plausibility import Plausibility
from lerobot_robot_yam.damiao.tables import Fault, motor_type


class FeedbackStore:
    """Newest feedback per motor, in motor coordinates.

    `take` works on lists, since storing one float into an array costs more than decoding the frame;
    `publish` turns them into arrays of shape (n,), new ones each time, so that a reader may keep them.

    Args:
        types: of the motors.
        turns: per motor, whether it may turn beyond the range of the wire, and is followed there.
    """

    def __init__(self, types: Sequence[str], turns: Sequence[bool]):
        self._types = list(types)
        self._ranges = [ranges_of(name) for name in types]
        rows = [motor_type(name) for name in types]
        # Half of the range that the wire carries positions modulo.
        self._half = [row.position_max_rad if turning else math.inf for row, turning in zip(rows, turns, strict=True)]
        self._judge = Plausibility(rows, turns)
        count = len(self._types)
        self._turn_rad = [0.0] * count
        self._position = [0.0] * count
        self._velocity = [0.0] * count
        self._torque = [0.0] * count
        self._temp_mos = [0.0] * count
        self._temp_rotor = [0.0] * count
        self._before_q = [math.nan] * count
        self._before_dq = [math.nan] * count
        self._stamp = [-math.inf] * count
        self._asked = [-math.inf] * count
        self._fault: list[int] = [Fault.DISABLED] * count
        self._normal: list[int] = [Fault.NORMAL] * count
        self._fresh = [True] * count  # the next reading says which turn it is on
        self.publish()

    def take(
        self, index: int, data: bytes, asked_s: float, sampled_s: float, latest_s: float, arrived_s: float
    ) -> None:
        """Decode one feedback frame, 8 bytes, of motor number `index`; use it if it can be. Hot: once per frame.

        Between two readings a motor that turns is taken to have gone the shorter way round; the first is taken as it
        is.

        Args:
            asked_s, arrived_s: when the command went out that this answers, and when this came.
            sampled_s, latest_s: when the motor has sampled in between: most likely, and at the latest.
        """
        _, fault, position, velocity, torque, mos, rotor = unpack_feedback(self._ranges[index], data)
        turn, half = self._turn_rad[index], self._half[index]
        position += turn
        if not self._fresh[index]:
            step = position - self._position[index]
            if step > half:
                turn -= 2.0 * half
                position -= 2.0 * half
            elif step < -half:
                turn += 2.0 * half
                position += 2.0 * half
        if not self._judge.accept(index, position, velocity, sampled_s, latest_s, asked_s, arrived_s):
            return
        self._fresh[index] = False
        self._turn_rad[index], self._position[index], self._velocity[index] = turn, position, velocity
        self._torque[index], self._fault[index] = torque, fault
        self._temp_mos[index], self._temp_rotor[index] = mos, rotor
        self._stamp[index], self._asked[index] = sampled_s, asked_s
        self._before_q[index], self._before_dq[index] = self._judge.before[index]

    def assume(self, position_rad: np.ndarray, velocity_rad_s: np.ndarray, sampled_s: np.ndarray) -> None:
        """Where motors were the last time that somebody has heard them, (n,) in motor coordinates.

        They are taken to be there until they answer, and their first answers are judged by it.
        """
        rows = zip(position_rad.tolist(), velocity_rad_s.tolist(), sampled_s.tolist(), strict=True)
        for index, (q, dq, at_s) in enumerate(rows):
            if math.isfinite(at_s):
                self._judge.assume(index, q, dq, at_s)
            if self._stamp[index] == -math.inf:
                self._position[index] = q
        self.publish()

    def restart(self, motors: Iterable[int] | None = None) -> None:
        """Take the next reading of these motors (default: all) as it is, on whatever turn, however far off."""
        chosen = range(len(self._types)) if motors is None else list(motors)
        self._judge.restart(chosen)
        for index in chosen:
            self._turn_rad[index], self._fresh[index] = 0.0, True

    def believe(self, motors: Iterable[int]) -> None:
        """Take the next readings of these motors however far off: limp joints may have been moved."""
        self._judge.restart(motors)

    def distrust(self, motors: Sequence[int], position_rad: np.ndarray) -> None:
        """Use no readings of these motors until `restart`; they are where they were believed last, (n,) in all."""
        self._judge.distrust(motors)
        for index in motors:
            self._position[index], self._velocity[index] = float(position_rad[index]), 0.0
        self.publish()

    @property
    def rejected(self) -> np.ndarray:
        """(n,) answers that could not be, in total."""
        return np.array(self._judge.rejected)

    def publish(self) -> None:
        """Make what was taken visible in the arrays."""
        motion = (self._position, self._velocity, self._torque)
        before = (self._before_q, self._before_dq)
        state = np.array((*motion, self._temp_mos, self._temp_rotor, self._stamp, self._asked, *before))
        self.position_rad, self.velocity_rad_s, self.torque_nm = state[0], state[1], state[2]
        self.temp_mos_c, self.temp_rotor_c, self.stamp_s, self.asked_s = state[3], state[4], state[5], state[6]
        self.before_rad, self.before_rad_s = state[7], state[8]
        self.fault = np.array(self._fault)
        self.distrusted = np.array(self._judge.distrusted)
        self.all_normal = self._fault == self._normal and not any(self._judge.distrusted)
