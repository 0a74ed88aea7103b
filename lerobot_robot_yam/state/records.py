"""Records shared by caller and control loop for each arm: the state (loop writes) and the command (caller writes).

A record has `MAX_MOTORS` slots: the joints, then the gripper if it has a motor; further slots are unused. The state
contains the numbers of joints and motors. SI units; gripper 0 closed … 1 open.

Each record has its own block. The caller allocates both blocks and passes their descriptors on, so no file is needed.
"""

import math
import os
import struct
import zlib
from collections.abc import Collection
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS
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
        ("stamp_doubt_s", "f8", MAX_MOTORS),  # time by which each motor's sample may be newer than its stamp
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

_STRUCT_CODES = {"f8": "d", "f4": "f", "u8": "Q", "u2": "H", "u1": "B"}


def packed(dtype: np.dtype, motors: int, only: Collection[str] | None = None) -> tuple[struct.Struct, dict[str, int]]:
    """Create a struct for a packed record type; return the struct, and each field's index among the unpacked values.

    Unpacked tuples are faster than numpy fields: a caller that wakes up 30 times a second has cold caches, with which
    reading a numpy field takes 6 times as long.

    Args:
        dtype: the record type.
        motors: number of used slots in per-motor fields; unused slots are skipped.
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


EACH_TICK = STATE_DTYPE.fields["stamp_s"][1], struct.Struct("<dQdBHBBd2Bd2Q")  # type: ignore[index]
"""Offset and layout of the fields that change at every tick, stamp_s … presses."""
OWNER = STATE_DTYPE.fields["owner_pid"][1], struct.Struct("<Q")  # type: ignore[index]
PUBLISHED = STATE_DTYPE.fields["stamp_s"][1], struct.Struct("<d")  # type: ignore[index]


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
