"""Faults of the link between a workstation and the arms' computer (host), in addition to the table in `faults`.

The host cannot distinguish these faults: the host only detects whether its client sends messages, and applies the rules
of `faults` for a caller that stalls or dies. The table is documentation; tests check each row.
"""

from enum import StrEnum

from lerobot_robot_yam.state.faults import PARENT_S, TICK_S, Response, Rule


class LinkFault(StrEnum):
    """Faults of both computers, their programs, and the network in between."""

    PROGRAM_DEAD = "workstation's program dies"
    WORKSTATION_DEAD = "workstation dies"
    LINK_PROCESS_DEAD = "link process dies"
    LINK_BRIEFLY_CUT = "link is cut briefly"
    LINK_CUT = "link is cut"
    LINK_GONE = "link stays away"
    HOST_DEAD = "host's program dies"
    HOST_CONTROL_DEAD = "host's control process dies"
    WORKSTATION_STOP = "workstation's emergency stop"
    HOST_STOP = "host's emergency stop"
    SECOND_CLIENT = "second client"


ASKED_S = 0.3  # maximum time from the end of the client program to the start of landing, s
SILENT_S = 0.5  # default of `command_timeout_s`
LAND_AFTER_S = 30.0  # default of yam-host's `--land_after_s`
STOPPED_S = 0.1  # maximum time for an emergency stop to cross the link, s

_STALE = "StaleStateError, never a state older than `max_state_age_s`"
_LATER = f"and lands after `--land_after_s`, {LAND_AFTER_S:g} s"
_LANDED = "connect again, once the arms have landed"


def _both(arm: Response, sign: str, caller: str, within_s: float, rearm: str) -> Rule:
    return Rule(sign, arm, arm, caller, within_s, rearm)


LINK_RESPONSES: dict[LinkFault, Rule] = {
    LinkFault.PROGRAM_DEAD: _both(
        Response.LAND,
        "the link process sees that its program is gone (exception, signal, kill -9), and asks the host to land, "
        "whether the arms hold, are led, go home or do what a policy says",
        "—",
        ASKED_S,
        "connect again",
    ),
    LinkFault.WORKSTATION_DEAD: _both(
        Response.HOLD_UNTIL_TARGET,
        f"no target for `command_timeout_s`: power or network of the workstation is gone. The arm waits {_LATER}",
        "—",
        SILENT_S,
        _LANDED,
    ),
    LinkFault.LINK_PROCESS_DEAD: _both(
        Response.HOLD_UNTIL_TARGET,
        f"no target for `command_timeout_s`. The arm waits {_LATER}",
        _STALE,
        SILENT_S,
        _LANDED,
    ),
    LinkFault.LINK_BRIEFLY_CUT: _both(
        Response.GO_ON,
        f"no target for less than `command_timeout_s`, {SILENT_S:g} s",
        "nothing; StaleStateError where no state comes for `max_state_age_s`, 0.25 s",
        0.0,
        "not needed",
    ),
    LinkFault.LINK_CUT: _both(
        Response.HOLD_UNTIL_TARGET,
        "no target for `command_timeout_s`. Targets that come when they are older are not taken, nor requests that are "
        "older than 1 s",
        _STALE,
        SILENT_S,
        "not needed: the next target, under the speed limits",
    ),
    LinkFault.LINK_GONE: _both(
        Response.LAND,
        f"no sign of life for `--land_after_s`, {LAND_AFTER_S:g} s; not while a leader is engaged and away from its "
        "rest: then once it is back there",
        f"{_STALE}; once the link is back MotorError: the host has let go of the arms",
        LAND_AFTER_S,
        "connect again",
    ),
    LinkFault.HOST_DEAD: _both(
        Response.LAND,
        "the control process sees that yam-host is gone, and lands alone",
        _STALE,
        PARENT_S,
        "start yam-host, then connect again",
    ),
    LinkFault.HOST_CONTROL_DEAD: _both(
        Response.LAND,
        "its stand-by sees that it is gone (kill -9)",
        "StaleStateError for a moment, then MotorError",
        0.1,
        "connect again",
    ),
    LinkFault.WORKSTATION_STOP: _both(
        Response.STOP,
        "`yam-estop` there; the host latches its own, and lands if it cannot write that down. A link that is down "
        "carries no stop: switch the power off",
        "observations go on; actions are answered with the pose held",
        STOPPED_S,
        "`yam-estop release` there; motion resumes from the measured pose",
    ),
    LinkFault.HOST_STOP: _both(
        Response.STOP,
        "`yam-estop` on the host, or from elsewhere with `--host`; the workstation latches its own, once the "
        "link is back if it is away",
        "observations go on; actions are answered with the pose held",
        TICK_S,
        "`yam-estop release` on the host, or with its name and `--host`",
    ),
    LinkFault.SECOND_CLIENT: _both(
        Response.GO_ON,
        "it asks for arms that another client has; watching is free",
        "of the second: ChannelInUseError that names the first",
        0.0,
        "not needed",
    ),
}
