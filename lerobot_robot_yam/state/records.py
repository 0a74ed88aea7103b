"""Records shared by caller and control loop for each arm: the state (loop writes) and the command (caller writes).

A record has `MAX_MOTORS` slots: the joints, then the gripper if it has a motor; further slots are unused. The state
contains the numbers of joints and motors. SI units; gripper 0 closed … 1 open.

Each record has its own block. The caller allocates both blocks and passes their descriptors on, so no file is needed.
"""

import math
import os
import struct
import zlib
from collections.abc import Callable
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.record_layout import packed
from lerobot_robot_yam.system.runtime_dirs import LOCK, STATE
from lerobot_robot_yam.system.runtime_files import runtime_dir, slug
from lerobot_robot_yam.system.shared_block import SharedBlock


class Limited(IntFlag):
    """Limits that act on an arm at this tick."""

    NOTHING = 0
    JOINT_LIMIT = 1
    RELATIVE_TARGET = 2
    SPEED = 4
    TORQUE = 8
    GRIPPER_FORCE = 16
    COMMAND_TIMEOUT = 32
    EMERGENCY_STOP = 64
    PEER = 128  # this arm holds because the other arm is in fault
    WORKSPACE = 256
    HEAT = 512
    CAME_FREE = 1024  # a joint came free of an obstacle and was stopped
    UNHEARD = 2048  # motors have not replied for some ticks; the set-point brakes until they do


class Request(IntEnum):
    """Requests of a caller other than targets."""

    NONE = 0
    HOLD = 1
    FLOAT = 2
    LAND = 3
    CALIBRATE_GRIPPER = 4
    REARM = 5
    GUIDE = 6  # float, with a gripper that follows targets
    GAINS = 7  # change the arm's own gains to the command's own_kp and own_kd
    CUT_TORQUE = 8  # cut torque at once, even if the arm falls; refused while the arm lands or is stopped


ACTION_SLOTS = MAX_MOTORS + 1  # slots of a follower's target: a follower may have one motor more than its leader

STATE_DTYPE = np.dtype(
    [
        ("owner_pid", "u8"),  # pid of the control loop's process; changes when another process takes over
        # `EACH_TICK` has the fields from stamp_s to presses.
        ("stamp_s", "f8"),  # monotonic time of publication
        ("tick", "u8"),
        ("asked_s", "f8"),  # monotonic time of the oldest command whose reply is among the motors' samples
        ("mode", "u1"),
        ("limited", "u2"),
        ("own_gains", "u1"),  # whether the configured gains are in force, not a target's or a caller's
        ("gripper_blocked", "u1"),
        ("trigger", "f8"),
        ("buttons", "u1", 2),
        ("handle_stamp_s", "f8"),
        ("presses", "u8", 2),  # presses of each button since the control loop began
        ("joints", "u1"),  # number of joints
        ("motors", "u1"),  # number of motors: joint motors, and the gripper motor if present
        ("q", "f8", MAX_MOTORS),
        ("dq", "f8", MAX_MOTORS),
        ("tau", "f8", MAX_MOTORS),
        ("setpoint", "f8", MAX_MOTORS),
        ("sunk", "u1", MAX_MOTORS),  # whether the joint sank off its set-point, with a silent motor, during a landing
        ("motor_stamp_s", "f8", MAX_MOTORS),  # monotonic time of each motor's newest sample
        ("temp_mos_c", "f4", MAX_MOTORS),
        ("temp_rotor_c", "f4", MAX_MOTORS),
        ("fault", "u1", MAX_MOTORS),
        ("distrusted", "u1", MAX_MOTORS),  # whether readings are ignored, and q is the last plausible reading
        ("lost", "u8", MAX_MOTORS),
        ("offset_rad", "f8", MAX_MOTORS),  # motor angle at joint zero, for a process that takes over the arm
        ("gripper_stops_rad", "f8", 2),  # motor angles closed, open; NaN while unknown
        ("gate", "u1"),  # a `Gate`
        # A follower's target: joints in rad, then the gripper; NaN in unused slots. In a leader's state: the target for
        # its follower; in a follower's state: the newest target accepted by its set-point.
        ("action", "f8", ACTION_SLOTS),
        ("action_dq", "f8", ACTION_SLOTS),  # rate of `action`, 1/s
        ("action_stamp_s", "f8"),  # monotonic time of `action`
        ("coupled_to", "u8"),  # `coupling_number` of the leader to which a follower is coupled; 0: none
        ("target_sequence", "u8"),  # number of the newest processed target
        ("request_sequence", "u8"),  # number of the newest request that was executed or refused
        ("request_refused", "u1"),
        ("refusal", "S400"),  # reason of the newest refusal
        ("trouble", "S40"),  # a `faults.Trouble`, or empty
        ("message", "S400"),
    ]
)


class Led(NamedTuple):
    """Permission of a caller for a follower to take its targets from a leader's state at loop rate.

    Attributes:
        leader: channel key of the leader; empty: no permission.
        button: number of the leader's button, from 1, whose next press takes the follower over; 0: it is permitted now.
        presses: `ArmState.presses` of this button that the caller has seen.
    """

    leader: str = ""
    button: int = 0
    presses: int = 0


NOT_LED = Led()
KEY_BYTES = 200  # maximum length of a channel key, which may contain a rig's name and a channel's name

COMMAND_DTYPE = np.dtype(
    [
        ("target_stamp_s", "f8"),
        ("target_sequence", "u8"),
        ("q", "f8", MAX_MOTORS),
        ("dq", "f8", MAX_MOTORS),  # NaN: computed by the loop from successive targets
        ("kp", "f8", MAX_MOTORS),  # NaN: as configured
        ("kd", "f8", MAX_MOTORS),
        ("own_kp", "f8", MAX_MOTORS),  # gains for targets without gains; NaN: as configured
        ("own_kd", "f8", MAX_MOTORS),
        ("leader", f"S{KEY_BYTES}"),  # channel key of the leader whose targets replace later ones; empty: none
        ("button", "u1"),  # button of this leader by which a person takes over, from 1; 0: its targets replace at once
        ("presses", "u8"),  # presses of this button that the caller knows of; one more takes over
        ("request_stamp_s", "f8"),
        ("request", "u1"),
        ("request_sequence", "u8"),
    ]
)

EACH_TICK = STATE_DTYPE.fields["stamp_s"][1], struct.Struct("<dQdBHBBd2Bd2Q")  # type: ignore[index]
"""Offset and layout of the fields that change at every tick, stamp_s … presses."""
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
    """State of one arm, measured at `stamp_s`. Each access to an array attribute returns a new array.

    Args:
        payload: bytes of a state record.
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
        """Present mode of the arm."""
        return _MODES[self._values[self._at["mode"]]]

    @property
    def limited(self) -> Limited:
        return Limited(self._values[self._at["limited"]])

    @property
    def gripper_stops_rad(self) -> tuple[float, float] | None:
        """Motor angles of the gripper's stops, closed and open, rad; None while unknown."""
        start = self._at["gripper_stops_rad"]
        closed, opened = self._values[start : start + 2]
        return None if math.isnan(closed) else (closed, opened)

    @property
    def trigger(self) -> float | None:
        """Trigger of the teaching handle, 0 released … 1 squeezed; None: no handle, or the handle is silent."""
        value = self._values[self._at["trigger"]]
        return None if math.isnan(value) else value

    @property
    def buttons(self) -> tuple[bool, bool]:
        """Buttons of the teaching handle; True: pressed."""
        first = self._at["buttons"]
        return bool(self._values[first]), bool(self._values[first + 1])

    @property
    def presses(self) -> tuple[int, int]:
        """Number of presses of each button since the control loop began, however short they were."""
        first = self._at["presses"]
        return self._values[first], self._values[first + 1]

    @property
    def gate(self) -> Gate:
        """State of a leader's gate; NONE if the arm leads no follower."""
        return _GATES[self._values[self._at["gate"]]]

    @property
    def action(self) -> tuple[float, ...] | None:
        """Target of a follower: joints in rad, then the gripper, 0 … 1; None: no target.

        In a leader's state: the target for its follower. In a follower's state: the newest target accepted by its
        set-point.
        """
        first = self._at["action"]
        values = self._values[first : first + ACTION_SLOTS]
        given = next((count for count, value in enumerate(values) if math.isnan(value)), ACTION_SLOTS)
        return values[:given] or None

    @property
    def coupled(self) -> bool:
        """Whether a follower reads its targets directly from a leader's state."""
        return self.coupled_to != 0

    @property
    def trouble(self) -> Trouble | None:
        """Fault of the arm; None: no fault."""
        return Trouble(self._trouble) if self._trouble else None

    @property
    def refusal(self) -> str | None:
        """Reason for the refusal of the newest request; None if the request was executed."""
        return self._refusal if self._values[self._at["request_refused"]] else None


class Descriptors(NamedTuple):
    """File descriptors of both blocks' shared memory, allocated by the caller."""

    states: int
    commands: int

    def copies(self) -> "Descriptors":
        """Duplicate the descriptors for a loop in this process, since a loop closes its descriptors."""
        return Descriptors(*map(os.dup, self))


class BlockPair(NamedTuple):
    """The loop's side of both blocks: the loop writes states and reads commands."""

    states: SharedBlock
    commands: SharedBlock

    @classmethod
    def of(cls, descriptors: Descriptors) -> "BlockPair":
        """Map the shared memory allocated by the caller."""
        return cls(
            SharedBlock(None, STATE_DTYPE, create=True, descriptor=descriptors.states),
            SharedBlock(None, COMMAND_DTYPE, create=False, descriptor=descriptors.commands),
        )

    def close(self) -> None:
        for block in self:
            block.close()


def channel_key(interface: str, channel: str, rig: str | None) -> str:
    """Return the key that names a channel's lock and blocks: `can_follower_l`, or `rig.follower_left` on a rig."""
    return slug(f"{rig}.{channel}" if rig else channel if interface == "socketcan" else f"{interface}.{channel}")


def coupling_number(key: str) -> int:
    """Return the number that identifies the arm with this channel key in state records; never 0."""
    return zlib.crc32(key.encode()) + 1


def state_path(key: str) -> Path:
    return runtime_dir() / f"{STATE}{key}"


def lock_path(key: str) -> Path:
    return runtime_dir() / f"{LOCK}{key}"
