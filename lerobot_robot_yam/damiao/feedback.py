"""The newest feedback of every motor of a chain: decoded, unwrapped over turns, stamped."""

import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.damiao.codec import ranges_of, unpack_feedback
from lerobot_robot_yam.damiao.tables import Fault, motor_type


class FeedbackStore:
    """Newest feedback per motor, in motor coordinates.

    `take` works on lists, since storing one float into an array costs more than decoding the frame;
    `publish` turns them into arrays of shape (n,), new ones each time, so that a reader may keep them.
    """

    def __init__(self, types: Sequence[str]):
        self._types = list(types)
        self._ranges = [ranges_of(name) for name in types]
        # Half of the range that the wire carries positions modulo.
        self._half = [motor_type(name).position_max_rad for name in types]
        count = len(self._types)
        self._raw = [math.nan] * count
        self._turns = [0] * count
        self._position = [0.0] * count
        self._velocity = [0.0] * count
        self._torque = [0.0] * count
        self._temp_mos = [0.0] * count
        self._temp_rotor = [0.0] * count
        self._stamp = [-math.inf] * count
        self._fault: list[int] = [Fault.DISABLED] * count
        self._normal: list[int] = [Fault.NORMAL] * count
        self.publish()

    def take(self, index: int, data: bytes, stamp_s: float) -> None:
        """Decode one feedback frame, 8 bytes, of motor number `index`. Hot: once per frame.

        Between two readings a motor is taken to have gone the shorter way round; the first is taken as it is.
        """
        feedback = unpack_feedback(self._ranges[index], data)
        _, self._fault[index], raw, self._velocity[index], self._torque[index], mos, rotor = feedback
        half = self._half[index]
        step = raw - self._raw[index]  # NaN at first, and comparisons with it are false
        if step > half:
            self._turns[index] -= 1
        elif step < -half:
            self._turns[index] += 1
        self._raw[index] = raw
        self._position[index] = raw + self._turns[index] * (half + half)
        self._temp_mos[index] = mos
        self._temp_rotor[index] = rotor
        self._stamp[index] = stamp_s

    def assume(self, position_rad: np.ndarray) -> None:
        """Where motors that have not answered yet are taken to be until they do, (n,) in motor coordinates."""
        for index, stamp_s in enumerate(self._stamp):
            if stamp_s == -math.inf:
                self._position[index] = float(position_rad[index])
        self.publish()

    def restart_turns(self) -> None:
        """Forget the turns: the next reading is taken as it is."""
        self._raw = [math.nan] * len(self._types)
        self._turns = [0] * len(self._types)

    def publish(self) -> None:
        """Make what was taken visible in the arrays."""
        state = np.array((self._position, self._velocity, self._torque, self._temp_mos, self._temp_rotor, self._stamp))
        self.position_rad, self.velocity_rad_s, self.torque_nm = state[0], state[1], state[2]
        self.temp_mos_c, self.temp_rotor_c, self.stamp_s = state[3], state[4], state[5]
        self.fault = np.array(self._fault)
        self.all_normal = self._fault == self._normal
