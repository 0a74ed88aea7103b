"""Address and type of a motor on its bus."""

from collections.abc import Sequence
from dataclasses import dataclass

from lerobot_robot_yam.damiao.tables import VELOCITY_OFFSET, ControlMode, ReceiveMode, motor_type
from lerobot_robot_yam.errors import ConfigError

MOTOR_IDS = range(1, 16)
"""Motor ids that one bus allows: those that the id nibble in feedback frames can distinguish."""
MAX_MOTORS = len(MOTOR_IDS)
"""Maximum number of motors on one bus."""


@dataclass(frozen=True)
class MotorSpec:
    """Motor on a bus: name for messages, CAN id of its commands, type (from `MOTOR_TYPES`), receive mode.

    `turns`: whether the motor may rotate beyond the position range of the frames, so that its readings are unwrapped.
    Joints of an arm never rotate that far: a reading that suggests so is rejected as impossible.
    `mode`: MIT; or VELOCITY, for wheels and rails.
    """

    name: str
    can_id: int
    type: str
    receive_mode: ReceiveMode = ReceiveMode.P16
    turns: bool = False
    mode: ControlMode = ControlMode.MIT

    @property
    def command_id(self) -> int:
        """CAN identifier of this motor's commands; special commands go to `can_id` in every mode."""
        return self.can_id + (VELOCITY_OFFSET if self.mode is ControlMode.VELOCITY else 0)

    @property
    def feedback_id(self) -> int:
        """CAN id of this motor's replies."""
        return self.receive_mode.feedback_id(self.can_id)

    @property
    def answer_key(self) -> int:
        """CAN id of the replies, shifted left by four bits, plus the id nibble inside them.

        So a motor with a wrong MST_ID is not mistaken for its neighbour, and several motors may reply on id 0.
        """
        return self.feedback_id << 4 | self.can_id & 0xF


def check_specs(motors: Sequence[MotorSpec], channel: str) -> None:
    """Check specs. Raises ConfigError: names, ids or replies are not unique, an id is out of range, a type unknown."""
    for values in (
        [spec.name for spec in motors],
        [spec.can_id for spec in motors],
        [spec.answer_key for spec in motors],
    ):
        if len(set(values)) < len(values):
            listing = ", ".join(f"{m.name}: id {m.can_id}, answers {m.feedback_id}" for m in motors)
            raise ConfigError(f"{channel}: motor names, ids and answers must be unique, got {listing}")
    commanded = {spec.can_id: spec.name for spec in motors}
    for spec in motors:
        if spec.feedback_id in commanded and commanded[spec.feedback_id] != spec.name:
            raise ConfigError(
                f"{channel}: motor {spec.name} answers on {spec.feedback_id}, which commands "
                f"{commanded[spec.feedback_id]}"
            )
        if not 1 <= spec.can_id <= 0xFF:
            raise ConfigError(f"{channel}: motor {spec.name} has CAN id {spec.can_id}; use 1 to 255")
        motor_type(spec.type)
