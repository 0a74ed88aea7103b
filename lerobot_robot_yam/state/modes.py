"""Modes of an arm and all permitted transitions.

An arm reaches OFF only through LAND, by an abandoned bring-up, or without ever having been energised.
"""

from enum import IntEnum


class Mode(IntEnum):
    """Mode of one arm, as published in its state block."""

    OFFLINE = 0  # not energised yet
    BRING_UP = 1  # energised and holding while gripper stops are searched or verified
    HOLD = 2  # keeps its set-point
    TRACK = 3  # the set-point follows the caller's targets
    FLOAT = 4  # gravity-compensated, can be moved by hand
    LAND = 5  # moves to a pose in which torque can be cut safely
    FAULT = 6  # a fault has occurred; all motors that obey hold
    OFF = 7  # landed, torque cut
    STOPPED = 8  # emergency stop: a follower holds, a leader floats if gravity compensation balances the arm


TRANSITIONS: dict[Mode, frozenset[Mode]] = {
    Mode.OFFLINE: frozenset({Mode.BRING_UP, Mode.LAND, Mode.OFF}),  # LAND: taken over from a dead loop
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
    """State of a leader's gate, which determines the follower's motion. See docs/teleoperation.md."""

    NONE = 0  # the leader has no follower
    HOMING = 1  # leader and follower move home
    IDLE = 2  # the follower stays; the leader floats until the gate opens
    APPROACH = 3  # the follower moves to the leader's pose
    ENGAGED = 4  # the follower tracks the leader's pose
    FINE = 5  # the follower tracks the leader's motion, scaled down
    RECENTRE = 6  # after FINE, the leader moves back to the follower's pose
