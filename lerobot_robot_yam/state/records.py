"""Records that caller and control loop share for each arm: the state (loop writes) and the command (caller writes).

A record has a slot for each motor that an arm can have: the joints, then the gripper if that has a motor; further
slots are unused. The state holds the numbers of joints and motors. SI units; gripper 0 closed … 1 open.

Each record has its own block. The caller allocates both blocks and passes their descriptors on, so no file is needed.
"""

import math
import os
import struct
import zlib
from collections.abc import Callable, Collection
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.system.runtime_files import LOCK, STATE, runtime_dir, slug
from lerobot_robot_yam.system.shared_block import SharedBlock


class Limited(IntFlag):
    """Limits that act on an arm in this tick."""

    NOTHING = 0
    JOINT_LIMIT = 1
    RELATIVE_TARGET = 2
    SPEED = 4
    TORQUE = 8
    GRIPPER_FORCE = 16
    COMMAND_TIMEOUT = 32
    EMERGENCY_STOP = 64
    PEER = 128  # the other arm is in trouble, so this one holds
    WORKSPACE = 256
    HEAT = 512
    CAME_FREE = 1024  # a joint sprang forward and was caught


class Request(IntEnum):
    """Requests of a caller, besides targets."""

    NONE = 0
    HOLD = 1
    FLOAT = 2
    LAND = 3
    CALIBRATE_GRIPPER = 4
    REARM = 5
    GUIDE = 6  # float, but the gripper follows targets
    GAINS = 7  # use own_kp and own_kd of the command
    CUT_TORQUE = 8  # cut torque at once, also in the air; refused while the arm lands or is stopped


ACTION_SLOTS = MAX_MOTORS + 1  # slots of a follower's target: followers may have one motor more than their leader

STATE_DTYPE = np.dtype(
    [
        ("owner_pid", "u8"),  # process whose loop drives the arm; changes when another process takes over
        # From here to handle_stamp_s: the fields of `EACH_TICK`.
        ("stamp_s", "f8"),  # monotonic time of publication
        ("tick", "u8"),
        ("asked_s", "f8"),  # monotonic time of the oldest command that a motor's sample answers
        ("mode", "u1"),
        ("limited", "u2"),
        ("own_gains", "u1"),  # whether the arm's own gains act, not softer ones of a target
        ("gripper_blocked", "u1"),
        ("trigger", "f8"),
        ("buttons", "u1", 2),
        ("handle_stamp_s", "f8"),
        ("joints", "u1"),  # number of joints
        ("motors", "u1"),  # number of motors: the joints', and the gripper's if it has one
        ("q", "f8", MAX_MOTORS),
        ("dq", "f8", MAX_MOTORS),
        ("tau", "f8", MAX_MOTORS),
        ("setpoint", "f8", MAX_MOTORS),
        ("sunk", "u1", MAX_MOTORS),  # whether a landing let the joint sink without replies, away from its set-point
        ("motor_stamp_s", "f8", MAX_MOTORS),  # monotonic time of each motor's newest sample
        ("temp_mos_c", "f4", MAX_MOTORS),
        ("temp_rotor_c", "f4", MAX_MOTORS),
        ("fault", "u1", MAX_MOTORS),
        ("distrusted", "u1", MAX_MOTORS),  # whether readings are ignored; then q is the last plausible reading
        ("lost", "u8", MAX_MOTORS),
        ("offset_rad", "f8", MAX_MOTORS),  # motor angle at joint zero, for a process that takes the arm over
        ("gripper_stops_rad", "f8", 2),  # closed, open; NaN until they are known
        ("gate", "u1"),  # a `Gate`
        # A follower's target, joints in rad and then its gripper; NaN in unused slots. In a leader's state it is the
        # target for its follower, in a follower's state the target that its set-point took last.
        ("action", "f8", ACTION_SLOTS),
        ("action_dq", "f8", ACTION_SLOTS),  # rate of `action`, 1/s
        ("action_stamp_s", "f8"),  # monotonic time of `action`
        ("coupled_to", "u8"),  # `coupling_number` of the leader that a follower follows; 0: none
        ("target_sequence", "u8"),  # number of the newest target that the set-point took
        ("request_sequence", "u8"),  # number of the newest request that was carried out or refused
        ("request_refused", "u1"),
        ("refusal", "S400"),  # reason of the newest refusal
        ("trouble", "S40"),  # a `faults.Trouble`, or empty
        ("message", "S400"),
    ]
)

KEY_BYTES = 200  # longest channel key, made of a channel's name and a rig's

COMMAND_DTYPE = np.dtype(
    [
        ("target_stamp_s", "f8"),
        ("target_sequence", "u8"),
        ("q", "f8", MAX_MOTORS),
        ("dq", "f8", MAX_MOTORS),  # NaN: the loop derives it
        ("kp", "f8", MAX_MOTORS),  # NaN: as configured
        ("kd", "f8", MAX_MOTORS),
        ("own_kp", "f8", MAX_MOTORS),  # gains for targets without gains; NaN: as configured
        ("own_kd", "f8", MAX_MOTORS),
        ("leader", f"S{KEY_BYTES}"),  # key of the leader that the target comes from; empty: none
        ("coupled_until_s", "f8"),  # time until which the loop may read targets from that leader's state
        ("request_stamp_s", "f8"),
        ("request", "u1"),
        ("request_sequence", "u8"),
    ]
)

_STRUCT_CODES = {"f8": "d", "f4": "f", "u8": "Q", "u2": "H", "u1": "B"}


def packed(dtype: np.dtype, motors: int, only: Collection[str] | None = None) -> tuple[struct.Struct, dict[str, int]]:
    """Make a struct of a packed record type, with the place of each field among its values; skip unused slots.

    Tuples are faster than numpy fields: a caller that wakes up 30 times a second has cold caches, and then a numpy
    field takes 6 times as long to read.

    Args:
        dtype: the record type.
        motors: used slots of fields that have one per motor.
        only: names of the fields to unpack; None: all.
    """
    layout, start, count = "<", {}, 0
    for name in dtype.names or ():
        field = dtype[name]
        if only is not None and name not in only:
            layout += f"{field.itemsize}x"
            continue
        length = math.prod(field.shape)
        used = motors if field.shape == (MAX_MOTORS,) else length
        start[name] = count
        if field.base.kind == "S":
            layout += f"{field.base.itemsize}s"
        else:
            layout += f"{used}{_STRUCT_CODES[field.base.str[1:]]}{(length - used) * field.base.itemsize}x"
        count += used
    return struct.Struct(layout), start


EACH_TICK = STATE_DTYPE.fields["stamp_s"][1], struct.Struct("<dQdBHBBd2Bd")  # type: ignore[index]
"""Offset and layout of the values that change at every tick, stamp_s … handle_stamp_s."""
_STATES = [packed(STATE_DTYPE, motors) for motors in range(MAX_MOTORS + 1)]
_JOINTS_AT, _MOTORS_AT = (STATE_DTYPE.fields[name][1] for name in ("joints", "motors"))  # type: ignore[index]
OWNER = STATE_DTYPE.fields["owner_pid"][1], struct.Struct("<Q")  # type: ignore[index]
PUBLISHED = STATE_DTYPE.fields["stamp_s"][1], struct.Struct("<d")  # type: ignore[index]
_MODES = {int(mode): mode for mode in Mode}
_GATES = {int(gate): gate for gate in Gate}


def _value(name: str, doc: str) -> Any:
    return property(lambda state: state._values[state._at[name]], doc=doc)


def _text(name: str, doc: str) -> Any:
    return property(lambda state: state._values[state._at[name]].rstrip(b"\0").decode(errors="replace"), doc=doc)


def _slots(name: str, doc: str, of: str = "_motors", make: Callable = tuple) -> Any:
    def get(state: "ArmState") -> Any:
        start = state._at[name]
        return make(state._values[start : start + getattr(state, of)])

    return property(get, doc=doc)


def _of_gripper(name: str, doc: str) -> Any:
    def get(state: "ArmState") -> float | None:
        return state._values[state._at[name] + state._joints] if state._motors > state._joints else None

    return property(get, doc=doc)


class ArmState:
    """State of one arm, as measured at `stamp_s`. Each access unpacks a value from the record, into a new array.

    Args:
        payload: the bytes of a state record.
    """

    __slots__ = ("_at", "_joints", "_motors", "_values")

    def __init__(self, payload: bytes):
        self._joints, self._motors = payload[_JOINTS_AT], payload[_MOTORS_AT]
        layout, self._at = _STATES[self._motors]
        self._values = layout.unpack(payload)

    def __repr__(self) -> str:
        q = ", ".join(f"{value:.3f}" for value in self.q)
        grip = "" if self.gripper is None else f", gripper={self.gripper:.2f}"
        wrong = f", {self.trouble}: {self.message}" if self.trouble else ""
        return f"<ArmState {self.mode.name} q=[{q}] rad{grip}, hottest {max(self.temp_mos_c):.0f} °C{wrong}>"

    q: np.ndarray = _slots("q", "(joints,) rad.", "_joints", np.array)
    dq: np.ndarray = _slots("dq", "(joints,) rad/s.", "_joints", np.array)
    tau_nm: np.ndarray = _slots("tau", "(joints,) Nm in joint coordinates.", "_joints", np.array)
    setpoint_q: np.ndarray = _slots("setpoint", "(joints,) rad.", "_joints", np.array)

    positions: tuple[float, ...] = _slots("q", "Joints in rad; behind them the gripper, 0 … 1, if it has a motor.")
    setpoints: tuple[float, ...] = _slots("setpoint", "As `positions`, of the set-point.")

    gripper: float | None = _of_gripper("q", "0 closed … 1 open; None without a gripper motor.")
    gripper_rate: float | None = _of_gripper("dq", "1/s; None without a gripper motor.")
    gripper_tau_nm: float | None = _of_gripper("tau", "Motor torque; None without a gripper motor.")
    gripper_setpoint: float | None = _of_gripper("setpoint", "0 … 1; None without a gripper motor.")

    motor_stamps_s: np.ndarray = _slots("motor_stamp_s", "(n,) monotonic time of each motor's sample.", make=np.array)
    stamp_s: float = _slots("motor_stamp_s", "Monotonic time of the oldest of these samples.", make=min)
    asked_s: float = _value("asked_s", "Monotonic time of the oldest command that a sample answers.")
    published_s: float = _value("stamp_s", "Monotonic time at which the control loop wrote this state.")
    tick: int = _value("tick", "Number of the control loop's tick.")

    temp_mos_c: np.ndarray = _slots("temp_mos_c", "(n,) °C per motor, power stage.", make=np.array)
    temp_rotor_c: np.ndarray = _slots("temp_rotor_c", "(n,) °C per motor, coil.", make=np.array)
    fault: tuple[int, ...] = _slots("fault", "Per motor, code of `damiao.tables.Fault`.")
    lost: tuple[int, ...] = _slots("lost", "Per motor, replies lost since connecting.")

    coupled_to: int = _value("coupled_to", "`coupling_number` of the leader that a follower follows; 0: none.")

    answered: int = _value("request_sequence", "Number of the newest request that was carried out or refused.")
    message: str = _text("message", "Why the arm is in its mode, empty when all is well.")
    _refusal: str = _text("refusal", "Why the newest refused request was refused.")
    _trouble: str = _text("trouble", "Value of a `Trouble`, empty when all is well.")

    @property
    def mode(self) -> Mode:
        """Mode of the arm."""
        return _MODES[self._values[self._at["mode"]]]

    @property
    def limited(self) -> Limited:
        return Limited(self._values[self._at["limited"]])

    @property
    def gripper_stops_rad(self) -> tuple[float, float] | None:
        """Motor angles of the gripper, closed and open; None while they are unknown."""
        start = self._at["gripper_stops_rad"]
        closed, opened = self._values[start : start + 2]
        return None if math.isnan(closed) else (closed, opened)

    @property
    def trigger(self) -> float | None:
        """Trigger of the teaching handle, 0 released … 1 squeezed; None without a handle or while it is silent."""
        value = self._values[self._at["trigger"]]
        return None if math.isnan(value) else value

    @property
    def buttons(self) -> tuple[bool, bool]:
        """Buttons of the teaching handle, True while pressed."""
        first = self._at["buttons"]
        return bool(self._values[first]), bool(self._values[first + 1])

    @property
    def gate(self) -> Gate:
        """State of a leader's gate; NONE without a follower."""
        return _GATES[self._values[self._at["gate"]]]

    @property
    def action(self) -> tuple[float, ...] | None:
        """Target of a follower, joints in rad and then its gripper, 0 … 1; None: no target.

        In a leader's state it is the target for its follower, in a follower's state the target that its set-point took
        last.
        """
        first = self._at["action"]
        values = self._values[first : first + ACTION_SLOTS]
        given = next((count for count, value in enumerate(values) if math.isnan(value)), ACTION_SLOTS)
        return values[:given] or None

    @property
    def coupled(self) -> bool:
        """Whether a follower takes its targets from a leader's state."""
        return self.coupled_to != 0

    @property
    def trouble(self) -> Trouble | None:
        """Trouble of the arm; None when all is well."""
        return Trouble(self._trouble) if self._trouble else None

    @property
    def refusal(self) -> str | None:
        """Reason for which the newest request was refused; None if it was not."""
        return self._refusal if self._values[self._at["request_refused"]] else None


class Descriptors(NamedTuple):
    """File descriptors of both blocks' memory, allocated by the caller."""

    states: int
    commands: int

    def copies(self) -> "Descriptors":
        """Duplicate the descriptors for a loop in this process, which closes its own."""
        return Descriptors(*map(os.dup, self))


class BlockPair(NamedTuple):
    """Loop's ends of both blocks: the loop writes states and reads commands."""

    states: SharedBlock
    commands: SharedBlock

    @classmethod
    def of(cls, descriptors: Descriptors) -> "BlockPair":
        """Map the memory that the caller has allocated."""
        return cls(
            SharedBlock(None, STATE_DTYPE, create=True, descriptor=descriptors.states),
            SharedBlock(None, COMMAND_DTYPE, create=False, descriptor=descriptors.commands),
        )

    def close(self) -> None:
        for block in self:
            block.close()


def channel_key(interface: str, channel: str, rig: str | None) -> str:
    """Return the name for a channel's lock and blocks: `can_follower_l`, or `rig.follower_left` on a virtual rig."""
    return slug(f"{rig}.{channel}" if rig else channel if interface == "socketcan" else f"{interface}.{channel}")


def coupling_number(key: str) -> int:
    """Return the number that identifies an arm, by its channel key, in state records; never 0."""
    return zlib.crc32(key.encode()) + 1


def state_path(key: str) -> Path:
    return runtime_dir() / f"{STATE}{key}"


def lock_path(key: str) -> Path:
    return runtime_dir() / f"{LOCK}{key}"
