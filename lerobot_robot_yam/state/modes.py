"""Modes of an arm and the only moves between them.

Torque is switched off (OFF) from a landed pose or when the arm was never energised; every other end goes through LAND.
"""

from enum import IntEnum


class Mode(IntEnum):
    """State of one arm as published in its state block."""

    OFFLINE = 0  # nothing is energised yet
    BRING_UP = 1  # energised and holding while gripper stops are found or verified
    HOLD = 2  # keeps its set-point
    TRACK = 3  # the set-point follows the caller's targets
    FLOAT = 4  # gravity-compensated, free to be moved by hand
    LAND = 5  # moves to a pose in which torque can be cut
    FAULT = 6  # a motor is lost or reports a fault; the others hold
    OFF = 7  # landed, torque cut
    STOPPED = 8  # emergency stop: a follower holds, a leader floats if it is in balance


TRANSITIONS: dict[Mode, frozenset[Mode]] = {
    Mode.OFFLINE: frozenset({Mode.BRING_UP, Mode.LAND, Mode.OFF}),  # LAND: taken over from a loop that has died
    Mode.BRING_UP: frozenset({Mode.HOLD, Mode.FLOAT, Mode.LAND, Mode.FAULT, Mode.STOPPED, Mode.OFF}),  # OFF: abandoned
    Mode.HOLD: frozenset({Mode.TRACK, Mode.FLOAT, Mode.LAND, Mode.FAULT, Mode.BRING_UP, Mode.STOPPED}),
    Mode.TRACK: frozenset({Mode.HOLD, Mode.FLOAT, Mode.LAND, Mode.FAULT, Mode.BRING_UP, Mode.STOPPED}),
    Mode.FLOAT: frozenset({Mode.HOLD, Mode.TRACK, Mode.LAND, Mode.FAULT, Mode.BRING_UP, Mode.STOPPED}),
    Mode.LAND: frozenset({Mode.OFF, Mode.FAULT, Mode.STOPPED}),
    Mode.FAULT: frozenset({Mode.LAND, Mode.OFF, Mode.HOLD, Mode.FLOAT, Mode.BRING_UP}),
    Mode.STOPPED: frozenset({Mode.HOLD, Mode.FLOAT, Mode.BRING_UP, Mode.FAULT}),
    Mode.OFF: frozenset(),
}

ENERGISED = frozenset(set(Mode) - {Mode.OFFLINE, Mode.OFF})


class Gate(IntEnum):
    """State of a leader's gate, which decides what its follower does. See docs/teleoperation.md."""

    NONE = 0  # the leader has no follower
    HOMING = 1  # leader and follower ramp home
    IDLE = 2  # the follower stays; the leader floats, and may engage
    APPROACH = 3  # the follower moves to the leader
    ENGAGED = 4  # the follower is at the leader and tracks it
    FINE = 5  # the follower tracks changes of the leader, scaled down
    RECENTRE = 6  # the leader moves back to the follower after FINE
