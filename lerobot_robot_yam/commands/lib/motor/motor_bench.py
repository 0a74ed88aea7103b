"""Motors of one arm or base for yam-motors: names from the profile, replies under each id, settings."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import can

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.mounting import gripper_id
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.commands.lib.dialogue import table, tell
from lerobot_robot_yam.control.preflight.fingerprint import MotorPrint
from lerobot_robot_yam.damiao.handle_check import handle_firmware
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.settings.motor_memory import (
    Contents,
    MotorState,
    read_contents,
    read_state,
    require_alone,
    require_limp,
)
from lerobot_robot_yam.damiao.settings.register_access import RegisterAccess, Reply
from lerobot_robot_yam.damiao.tables import REGISTER_ID, TIMEOUT_COUNT_S, fault_text
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase

SAFE_COUNTS = 8000
"""Factory value of TIMEOUT, 0.4 s; sessions refuse an arm with any other value."""
ANSWERS_BEYOND = 16
"""Offset from the CAN id of an arm's motor to the identifier of the motor's replies."""
_GRIPPER = "gripper"
_MARKS = (Register.GR, Register.PMAX, Register.VMAX, Register.TMAX)  # registers that identify the type of a motor
_HEAD = [
    *("motor", "id", "answers", "type", "firmware", "state", "rad", "stage °C", "coil °C"),
    *("limits rad, rad/s, Nm", "off at °C", "time-out s", "supply V"),
]


@dataclass(frozen=True)
class Found:
    """Motors found under one CAN id. Contents and state are known only if exactly one motor replies."""

    replies: list[Reply]
    contents: Contents
    state: MotorState | None


class MotorBench:
    """Motors of one arm or base on a bus that only this command uses.

    Args:
        config: config of the arm or base.
        bus: open bus, for exclusive use.
    """

    def __init__(self, config: ArmConfig | BaseConfig, bus: can.BusABC):
        self.config, self.channel, self.bus = config, config.channel, bus
        self.access = RegisterAccess(bus, config.channel)
        self.names = motor_names(config)

    def name(self, can_id: int) -> str:
        """Return the motor's name in the profile, or "motor ID" if the profile has no such motor."""
        return self.names.get(can_id, f"motor {can_id}")

    def ids(self, chosen: Sequence[str] | None) -> list[int]:
        """Return the CAN ids of the `chosen` motors (names or ids); if `chosen` is empty, of all motors that reply.

        Raises:
            ConfigError: an entry of `chosen` is neither a motor's name nor a CAN id.
            MotorError: `chosen` is empty, and no motor replies.
        """
        if not chosen:
            present = [can_id for can_id in self.names if self.access.replies(can_id, Register.ESC_ID)]
            if not present:
                raise MotorError(nothing_answers(self.channel))
            missing = [name for can_id, name in self.names.items() if can_id not in present and name != _GRIPPER]
            if missing:  # never lists the gripper's motor, which a leader lacks
                tell(f"note: without {', '.join(missing)}: no answer")
            return present
        by_name = {name: can_id for can_id, name in self.names.items()}
        for word in chosen:
            if word not in by_name and not (word.isdecimal() and int(word) <= REGISTER_ID):
                raise ConfigError(f"no motor {word!r}; give a CAN id, or one of {', '.join(by_name)}")
        return list(dict.fromkeys(by_name[word] if word in by_name else int(word) for word in chosen))

    def contents(self, can_id: int) -> Contents:
        """Read all registers of a motor. Raises MotorError: the motor does not reply."""
        found = read_contents(self.access, can_id)
        if Register.MST_ID not in found:
            raise MotorError(
                f"{self.channel}: {self.name(can_id)} (id {can_id}) does not answer; check its power and cable, and "
                "look for it under another id (yam-motors scan)"
            )
        return found

    def kind(self, contents: Contents) -> str:
        """Return the motor type with this gear ratio and these ranges; "?" if `contents` is empty."""
        ratio, position, speed, torque = map(contents.get, _MARKS)
        return MotorPrint(ratio, position, speed, torque, None, None, None, None).kind if contents else "?"

    def require_settable(self, ids: Sequence[int]) -> None:
        """Check that each motor is limp and the only one with its CAN id. Raises MotorError: a motor is not."""
        for can_id in ids:
            require_alone(self.access, can_id, self.name(can_id))
            require_limp(self.access, can_id, self.name(can_id))

    def scan(self, ids: Sequence[int]) -> dict[int, Found]:
        """Read registers and state of the motors with these ids; return id -> findings, without silent ids."""
        found = {}
        for can_id in ids:
            replies = self.access.find(can_id)
            if len(replies) == 1:
                contents = read_contents(self.access, can_id)
                found[can_id] = Found(replies, contents, read_state(self.access, can_id))
            elif replies:
                found[can_id] = Found(replies, {}, None)
        return found

    def notes(self, found: dict[int, Found]) -> list[str]:
        """Return one line per problem of the found motors, with the command that fixes the problem."""
        lines, where = [], self.config.on_command_line
        for can_id, motor in found.items():
            name, (first, *more), wanted = self.name(can_id), motor.replies, can_id + ANSWERS_BEYOND
            set_id = f"yam-motors set-id {where} {can_id}"
            if more:
                lines.append(
                    f"{len(motor.replies)} motors answer to id {can_id}: unplug all but one, then give that one its "
                    f"own id ({set_id} NEW)"
                )
            elif first.identifier != first.value:
                lines.append(
                    f"{name} answers as 0x{first.identifier:X}, which is not its MST_ID: switch the power off and on"
                )
            elif first.value != wanted:
                lines.append(f"{name} answers as {first.value}, not {wanted}: {set_id} {can_id}")
            if motor.contents.get(Register.TIMEOUT, SAFE_COUNTS) != SAFE_COUNTS:
                lines.append(f"{name} has another time-out than sessions ask for: yam-motors timeout {where} 0.4")
        missing = [f"{name} (id {can_id})" for can_id, name in self.names.items() if can_id not in found]
        wants_gripper = _GRIPPER in self.names.values() and _GRIPPER not in map(self.name, found)
        if wants_gripper and handle_firmware(self.bus, self.channel) is not None:
            missing.pop()
            lines.append(f"a teaching handle answers instead of a gripper's motor (yam-handle show {where})")
        if missing:
            lines.append(f"no answer from {', '.join(missing)}")
        return lines

    def row(self, can_id: int, motor: Found) -> dict[str, Any]:
        """Return a motor's row in the output of `yam-motors scan`, for JSON."""
        held, state = motor.contents.get, motor.state
        counts = held(Register.TIMEOUT)
        return {
            "name": self.name(can_id),
            "answers": [reply.identifier for reply in motor.replies],
            "type": self.kind(motor.contents),
            "firmware": held(Register.SW_VER),
            "sub": held(Register.SUB_VER),
            "serial": held(Register.SN),
            "state": None if state is None else state._asdict(),
            "ranges": [held(r) for r in (Register.PMAX, Register.VMAX, Register.TMAX)],
            "off_at_c": held(Register.OT_VALUE),
            "timeout_s": None if counts is None else round(counts * TIMEOUT_COUNT_S, 6),
            "supply_v": held(Register.VBUS),
        }

    def show(self, found: dict[int, Found]) -> str:
        """Return the findings of `scan` as a text table."""
        rows = []
        for can_id, motor in found.items():
            row, state = self.row(can_id, motor), ["no feedback", "?", "?", "?"]
            if (fed := motor.state) is not None:
                state = [fault_text(fed.fault), f"{fed.position_rad:+.3f}", str(fed.temp_mos_c), str(fed.temp_rotor_c)]
            firmware, ranges = f"{_text(row['firmware'])}.{_text(row['sub'])}", " ".join(map(_text, row["ranges"]))
            first = [row["name"], str(can_id), "+".join(map(str, row["answers"])), row["type"], firmware]
            rows.append([*first, *state, ranges, *(_text(row[key]) for key in ("off_at_c", "timeout_s", "supply_v"))])
        return table(_HEAD, rows)


def motor_names(config: ArmConfig | BaseConfig) -> dict[int, str]:
    """Return CAN id -> name of the motors. Raises ConfigError: the arm's profile does not exist."""
    if isinstance(config, BaseConfig):
        return {motor.can_id: motor.name for motor in ResolvedBase(config).motors}
    arm = load_arm(config.arm)
    return {motor.can_id: motor.name for motor in arm.motors} | {gripper_id(arm): _GRIPPER}


def nothing_answers(channel: str) -> str:
    """Return the message for a channel without any reply, with the possible causes."""
    return (
        f"nothing answers on channel {channel}; check motor power and the emergency stop, the CAN cable and the "
        "bit-rate (classic CAN, 1 Mbit/s)"
    )


def _text(value: float | None) -> str:
    return "?" if value is None else f"{value:g}"
