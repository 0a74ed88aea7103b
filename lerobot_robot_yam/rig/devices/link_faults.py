"""What can be made to fail between a motor and its driver, for tests."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

from lerobot_robot_yam.rig.devices.packets import Frame


@dataclass
class LinkFaults:
    """Everything off by default."""

    silent: bool = False  # neither obeys nor answers, as if unpowered
    drop_next: int = 0  # so many answers are lost
    loss_rate: float = 0.0  # share of answers lost
    command_loss_rate: float = 0.0  # share of commands and requests that the motor does not hear
    delay_s: float = 0.0  # answers come so much late
    wrong_id: int | None = None  # answers come under this identifier; the registers know nothing of it
    corrupt_rate: float = 0.0  # share of answers with random contents
    corrupt_all: bool = False  # also in the first byte: motor number and fault code
    set: bool = field(default=False, init=False)  # whether anything is not as it is by default; kept up to date

    def __setattr__(self, name: str, value: object) -> None:
        super().__setattr__(name, value)
        others = (row for row in fields(self) if row.name != "set")
        self.__dict__["set"] = any(self.__dict__.get(row.name, row.default) != row.default for row in others)

    def any(self) -> bool:
        """Whether something is set that concerns the answers on the wire."""
        return bool(self.drop_next or self.loss_rate or self.delay_s or self.corrupt_rate or self.wrong_id is not None)

    def unheard(self, chance: random.Random) -> bool:
        """Whether the frame that comes now is lost on its way to the motor."""
        return self.command_loss_rate > 0.0 and chance.random() < self.command_loss_rate

    def spoil(self, answer: Frame, chance: random.Random) -> Sequence[Frame]:
        """What remains of an answer; `delay_s` is for the caller to heed."""
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
