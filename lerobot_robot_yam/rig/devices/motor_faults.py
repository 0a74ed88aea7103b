"""Injected faults of a motor: lost frames and false measurements."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

from lerobot_robot_yam.rig.devices.packets import Frame

State = tuple[float, float, float]
"""Position in rad, velocity in rad/s, torque in Nm."""


@dataclass
class LinkFaults:
    """Faults between a motor and its driver; none by default."""

    silent: bool = False  # no frame is obeyed or answered, as without power
    drop_next: int = 0  # number of replies to drop
    loss_rate: float = 0.0  # fraction of replies that are lost
    command_loss_rate: float = 0.0  # fraction of commands and requests that do not reach the motor
    wrong_id: int | None = None  # identifier of replies instead of the one in the registers
    corrupt_rate: float = 0.0  # fraction of replies with random contents
    corrupt_all: bool = False  # whether the first byte, motor number and fault code, is random too
    set: bool = field(default=False, init=False)  # whether any other field differs from its default

    def __setattr__(self, name: str, value: object) -> None:
        super().__setattr__(name, value)
        others = (row for row in fields(self) if row.name != "set")
        self.__dict__["set"] = any(self.__dict__.get(row.name, row.default) != row.default for row in others)

    def any(self) -> bool:
        """Return whether a fault changes the replies on the wire."""
        return bool(self.drop_next or self.loss_rate or self.corrupt_rate or self.wrong_id is not None)

    def unheard(self, chance: random.Random) -> bool:
        """Decide at random whether the current frame is lost before it reaches the motor."""
        return self.command_loss_rate > 0.0 and chance.random() < self.command_loss_rate

    def spoil(self, answer: Frame, chance: random.Random) -> Sequence[Frame]:
        """Apply the faults to a reply; return the frames that remain."""
        if self.drop_next > 0:
            self.drop_next -= 1
            return ()
        if self.loss_rate and chance.random() < self.loss_rate:
            return ()
        if self.wrong_id is not None:
            answer = answer._replace(id=self.wrong_id)
        if self.corrupt_rate and chance.random() < self.corrupt_rate:
            kept = b"" if self.corrupt_all else answer.data[:1]
            answer = answer._replace(data=kept + chance.randbytes(len(answer.data) - len(kept)))
        return (answer,)


@dataclass
class FalseReading:
    """Offsets (joint sign) for the next `answers` replies, None for all; with `freeze`, all repeat the first reply.

    The position's offset grows by `drift_rad` with each reply. `scale` multiplies the true position and speed.
    The motor's own servo uses the true values.
    """

    position_rad: float = 0.0
    velocity_rad_s: float = 0.0
    torque_nm: float = 0.0
    drift_rad: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    answers: int | None = None
    freeze: bool = False
    _frozen: State | None = field(default=None, init=False)

    def of(self, true: State, direction: int) -> State:
        """Return what the faulty motor reports when its true state is `true`; both in the motor's sign convention."""
        if self.answers is not None:
            if self.answers <= 0:
                return true
            self.answers -= 1
        self.position_rad += self.drift_rad
        position = true[0] * self.scale[0] + direction * self.position_rad
        velocity = true[1] * self.scale[1] + direction * self.velocity_rad_s
        torque = true[2] + direction * self.torque_nm
        if not self.freeze:
            return position, velocity, torque
        self._frozen = self._frozen or (position, velocity, torque)
        return self._frozen
