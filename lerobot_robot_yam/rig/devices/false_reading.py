"""A motor that measures itself wrong: its answers lie, and its own servo does not know."""

from dataclasses import dataclass, field

State = tuple[float, float, float]
"""Position in rad, velocity in rad/s, torque in Nm."""


@dataclass
class FalseReading:
    """What is added to the next `answers` answers (None: to all), joint sign; `freeze`: all repeat the first one."""

    position_rad: float = 0.0
    velocity_rad_s: float = 0.0
    torque_nm: float = 0.0
    answers: int | None = None
    freeze: bool = False
    _frozen: State | None = field(default=None, init=False)

    def of(self, true: State, direction: int) -> State:
        """What an answer says in place of the true state, both in the motor's sign."""
        if self.answers is not None:
            if self.answers <= 0:
                return true
            self.answers -= 1
        offsets = self.position_rad, self.velocity_rad_s, self.torque_nm
        position, velocity, torque = (value + direction * offset for value, offset in zip(true, offsets, strict=True))
        if not self.freeze:
            return position, velocity, torque
        self._frozen = self._frozen or (position, velocity, torque)
        return self._frozen
