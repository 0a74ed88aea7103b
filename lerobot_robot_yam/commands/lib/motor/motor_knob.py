"""What the keys of the console turn: a target for one motor. Pure, no I/O.

tau = kp (q* − q) − kd dq. The set-point q* goes to the target at a limited speed, and stays so near to q that
kp |q* − q| is within the torque limit.
"""

from collections.abc import Callable
from dataclasses import dataclass

from lerobot_robot_yam.damiao.codec import encode_mit

HELP = "left/right: target   up/down: step   k/K: kp   d/D: kd   space: stay here   q: let down and quit"
SPEED_RAD_S = 0.5
_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2)  # rad
_GAIN_FACTOR = 1.25
_SMALLEST_KP = 1.0

LEFT, RIGHT, UP, DOWN = "\x1b[D", "\x1b[C", "\x1b[A", "\x1b[B"


@dataclass
class Knob:
    """Target of one motor, in motor coordinates.

    Args:
        kind: motor type.
        start_rad: where it is; the target stays within `range_rad` of it.
        torque_nm: the most that the position error may ask for.
    """

    kind: str
    start_rad: float
    range_rad: float
    torque_nm: float
    kp: float = 10.0
    kd: float = 1.0

    def __post_init__(self) -> None:
        self.setpoint_rad = self.start_rad
        self.target = self.start_rad
        self._step = 2

    @property
    def step(self) -> float:
        """What an arrow key adds, rad."""
        return _STEPS[self._step]

    def press(self, key: str) -> None:
        """One key; others than those of `HELP` do nothing."""
        actions: dict[str, Callable[[], None]] = {
            LEFT: lambda: self._aim(self.target - self.step),
            RIGHT: lambda: self._aim(self.target + self.step),
            UP: lambda: self._stride(1),
            DOWN: lambda: self._stride(-1),
            " ": self.stay,
            "k": lambda: self._gains(self.kp / _GAIN_FACTOR, self.kd),
            "K": lambda: self._gains(self.kp * _GAIN_FACTOR, self.kd),
            "d": lambda: self._gains(self.kp, self.kd / _GAIN_FACTOR),
            "D": lambda: self._gains(self.kp, self.kd * _GAIN_FACTOR),
        }
        if key in actions:
            actions[key]()

    def stay(self) -> None:
        """Go nowhere from here."""
        self._aim(self.setpoint_rad)

    def command(self, q: float, elapsed_s: float) -> bytes:
        """The next command's 8 bytes. `q`: where the motor is, rad; `elapsed_s`: since the last."""
        way = SPEED_RAD_S * elapsed_s
        lead = self.torque_nm / self.kp
        moved = min(max(self.target, self.setpoint_rad - way), self.setpoint_rad + way)
        self.setpoint_rad = min(max(moved, q - lead), q + lead)
        return encode_mit(self.kind, self.setpoint_rad, 0.0, self.kp, self.kd, 0.0)

    def _aim(self, target: float) -> None:
        self.target = min(max(target, self.start_rad - self.range_rad), self.start_rad + self.range_rad)

    def _stride(self, by: int) -> None:
        self._step = min(max(self._step + by, 0), len(_STEPS) - 1)

    def _gains(self, kp: float, kd: float) -> None:
        self.kp, self.kd = min(max(kp, _SMALLEST_KP), 100.0), min(max(kd, 0.1), 5.0)
