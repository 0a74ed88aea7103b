"""Fault table: detection of each fault and response of the arms. Used by the control loop, `fault_page` and tests."""

from dataclasses import dataclass
from enum import StrEnum

from lerobot_robot_yam.damiao.tables import Fault


class Response(StrEnum):
    """Responses of an arm; see docs/faults.md for explanations."""

    GO_ON = "goes on"
    HOLD = "holds"
    HOLD_UNTIL_TARGET = "waits"
    STOP = "stops"
    LAND = "lands"
    LOST = "lost"
    REFUSE = "refused"


MEANING = {
    Response.GO_ON: "does what it did",
    Response.HOLD: "holds with every motor that still obeys (one that has cut its torque is limp); targets are ignored "
    "until it is re-armed",
    Response.HOLD_UNTIL_TARGET: "brakes and holds; the next target moves it on, from where it is",
    Response.STOP: "emergency stop, latched: followers hold, leaders float",
    Response.LAND: "folds down and cuts torque there",
    Response.LOST: "cannot be reached: its motors keep the last command for 0.4 s, then end torque by themselves, and "
    "it falls",
    Response.REFUSE: "is not energised",
}


class Trouble(StrEnum):
    """Faults of an arm, its bus, its loop or its caller."""

    OVER_VOLTAGE = "over-voltage"
    UNDER_VOLTAGE = "under-voltage"
    OVER_CURRENT = "over-current"
    MOS_TOO_HOT = "power stage over-temperature"
    ROTOR_TOO_HOT = "coil over-temperature"
    COMMUNICATION_LOST = "communication loss"
    OVERLOAD = "overload"
    DISABLED = "motor disabled by somebody else"
    REPLY_LOST = "one reply lost"
    REPLIES_LOST = "burst of lost replies"
    MOTOR_SILENT = "motor silent"
    BUS_SILENT = "whole channel silent"
    BUS_OFF = "bus-off"
    LINK_DOWN = "interface down"
    ADAPTER_GONE = "adapter unplugged"
    IMPLAUSIBLE = "readings that cannot be"
    WRONG_ID = "motor with a wrong id"
    DUPLICATE_ID = "two motors with one id"
    FOREIGN_DRIVER = "another driver on the channel"
    ENCODER_SILENT = "teaching handle silent"
    WARM = "motor warm"
    HOT = "motor about to trip"
    EFFORT = "effort limit exceeded"
    EMERGENCY_STOP = "emergency stop"
    CALLER_STALE = "caller stalls"
    CALLER_DEAD = "caller dies"
    CAMERA_DEAD = "camera stalls or dies"
    CONTROL_DEAD = "control process dies"
    CONTROL_HUNG = "control process hangs"
    STAND_BY_DEAD = "stand-by process dies"
    LOOP_SLOW = "slow loop"
    INTERNAL_ERROR = "defect in our own code"
    GRIPPER = "gripper stops not found"
    OBSTRUCTED = "landing obstructed"
    WEIGHT = "weight is not the model's"
    RUNAWAY = "floats away by itself"
    LEADER_LOST = "leader of a coupled follower lost"
    FOLLOWER_LOST = "follower of a leader lost"
    STEERING_STALLED = "steering stalled"
    BASE_BLOCKED = "base blocked"
    RAIL_SILENT = "rail's switches and brake silent"
    RAIL_CABLE = "rail's switch cable off"
    RAIL_SWITCH = "rail switch stuck or off"
    RAIL_BRAKE = "rail's brake does not hold"
    RAIL_BLOCKED = "rail does not follow"
    RAIL_HOMING = "rail's homing fails"


@dataclass(frozen=True)
class Rule:
    """Row of the fault table.

    Attributes:
        sign: how the fault is detected.
        arm: response of the arm in fault.
        peer: response of the other arm of the same robot.
        caller: effect visible to the caller.
        within_s: maximum time from the fault to the response, s.
        rearm: action required to use the arm again. Torque never returns without this action.
    """

    sign: str
    arm: Response
    peer: Response
    caller: str
    within_s: float
    rearm: str

    @property
    def in_place(self) -> bool:
        """Whether `rearm()` can end the fault without a new connection."""
        return self.rearm == _REARM


_REARM = "`rearm()` once the cause is gone, or connect again"
_RECONNECT = "connect again"
_MOTOR_ERROR = "MotorError that names motor and cause"
_RAIL_ERROR = "MotorError; the brake is engaged at once, the motor stops and the base brakes"
PARENT_S = 0.03  # maximum time to detect a dead caller, s: callers are checked every 20 ms
TICK_S = 0.01  # time for one tick of the loop and one read by its caller, rounded up, s
SILENT_S = 0.15  # silence after which a motor is lost, s: a shorter dropout is a pause; watchdogs act after 0.4 s
RAIL_SILENT_S = 0.1  # silence after which a rail's switches and brake are lost, s: a carriage runs on meanwhile
HEAT_S = 0.6  # maximum time to detect heat, s: a temperature counts once steady for half a second
HUNG_S = 0.14  # time without a tick after which the stand-by replaces a loop, s: a third of the motors' watchdog time
MOST_RAD_S2 = 30.0  # acceleration limit of a calm arm, rad/s²
STALE_OVERSHOOT_RAD_S = 1.6  # maximum excess speed of its joint that obeys a stale command, rad/s: a·√(I/kp)


def stale_overshoot_rad_s(late_s: float) -> float:
    """Return a calm arm's excess speed, rad/s, of a joint that obeys an accelerating command for `late_s` too long."""
    return min(MOST_RAD_S2 * max(late_s, 0.0), STALE_OVERSHOOT_RAD_S)


def _go_on(sign: str, caller: str, within_s: float, rearm: str = "not needed") -> Rule:
    return Rule(sign, Response.GO_ON, Response.GO_ON, caller, within_s, rearm)


def _hold(sign: str, within_s: float, caller: str = _MOTOR_ERROR, rearm: str = _REARM) -> Rule:
    return Rule(sign, Response.HOLD, Response.HOLD, caller, within_s, rearm)


def _stop(sign: str, within_s: float, caller: str, rearm: str) -> Rule:
    return Rule(sign, Response.STOP, Response.STOP, caller, within_s, rearm)


def _land(sign: str, within_s: float, caller: str = "MotorError") -> Rule:
    return Rule(sign, Response.LAND, Response.LAND, caller, within_s, _RECONNECT)


def _lose(sign: str, within_s: float) -> Rule:
    error = "MotorError that names the channel"
    return Rule(sign, Response.LOST, Response.HOLD, error, within_s, f"repair the link, then {_RECONNECT}")


FAULT_TROUBLE: dict[int, Trouble] = {
    Fault.OVER_VOLTAGE: Trouble.OVER_VOLTAGE,
    Fault.UNDER_VOLTAGE: Trouble.UNDER_VOLTAGE,
    Fault.OVER_CURRENT: Trouble.OVER_CURRENT,
    Fault.MOS_OVER_TEMPERATURE: Trouble.MOS_TOO_HOT,
    Fault.ROTOR_OVER_TEMPERATURE: Trouble.ROTOR_TOO_HOT,
    Fault.COMMUNICATION_LOST: Trouble.COMMUNICATION_LOST,
    Fault.OVERLOAD: Trouble.OVERLOAD,
    Fault.DISABLED: Trouble.DISABLED,
}
"""Fault for each motor fault code; undocumented codes count as overload."""

_CUT = "the motor reports code 0x{:X}; it has no torque then"

RESPONSES: dict[Trouble, Rule] = {
    **{trouble: _hold(_CUT.format(code), TICK_S) for code, trouble in FAULT_TROUBLE.items()},
    Trouble.REPLY_LOST: _go_on("a reply misses its tick", "nothing; counted in the state", 0.0),
    Trouble.REPLIES_LOST: _go_on(
        f"several in a row, for less than {SILENT_S} s",
        "nothing; followers brake and wait, and all go on without a jump; the state says how old it is, and is refused "
        "when older than `max_state_age_s`",
        0.0,
    ),
    Trouble.MOTOR_SILENT: _hold(f"no answer for {SILENT_S} s and ten questions", 0.2),
    Trouble.BUS_SILENT: _lose(f"no motor of the channel answers for {SILENT_S} s", 0.2),
    Trouble.BUS_OFF: _lose("frames are no longer taken, or no motor answers", 0.15),
    Trouble.LINK_DOWN: _lose("sending fails: network is down", TICK_S),
    Trouble.ADAPTER_GONE: _lose("sending or receiving fails: no such device, or in a way that nobody knows", TICK_S),
    Trouble.IMPLAUSIBLE: _hold(
        "four answers of a motor that its joint cannot have reached since the last good one, alone or as a drift, or "
        "that its torque contradicts; single ones are not used",
        0.05,
    ),
    Trouble.WRONG_ID: Rule(
        "at bring-up: no answer, and unknown ids are named; later: a silent motor",
        Response.REFUSE,
        Response.REFUSE,
        _MOTOR_ERROR,
        1.0,
        "give the motor its id",
    ),
    Trouble.DUPLICATE_ID: _hold(
        "more answers than questions",
        0.5,
        f"{_MOTOR_ERROR}; at bring-up the arm is not energised",
        f"give every motor its own id, then {_RECONNECT}",
    ),
    Trouble.FOREIGN_DRIVER: _hold(
        "commands to our motors that are not ours",
        0.5,
        "MotorError; at bring-up ChannelInUseError and the arm is not energised",
        f"stop the other program, then {_RECONNECT}",
    ),
    Trouble.ENCODER_SILENT: _go_on(
        "no report for 0.25 s",
        "a warning once; trigger and buttons are None, the gripper keeps its opening; at bring-up MotorError",
        0.3,
        "not needed: it is read again as soon as it answers",
    ),
    Trouble.WARM: _go_on(
        "within 15 °C of where the motor switches itself off",
        "a warning; half speed, reduced grip",
        HEAT_S,
        "not needed: ends 3 °C lower",
    ),
    Trouble.HOT: Rule(
        "within 5 °C of where the motor switches itself off",
        Response.LAND,
        Response.HOLD,
        _MOTOR_ERROR,
        HEAT_S,
        f"let it cool, then {_RECONNECT}",
    ),
    Trouble.EFFORT: _stop(
        "torque beyond what weight and motion need above `effort_limit_nm` for 50 ms, except in a landing",
        0.1,
        "the emergency stop is latched; observations go on",
        "`yam-estop release` with the arm's name",
    ),
    Trouble.EMERGENCY_STOP: _stop(
        "`yam-estop`, `EmergencyStop().latch()`, or the handle button of `estop_button`",
        TICK_S,
        "observations go on (unless a gripper's stops are unknown); actions are answered with the pose held",
        "`yam-estop release`, with the names of other sources; motion resumes from the measured pose",
    ),
    Trouble.CALLER_STALE: Rule(
        "no target for `command_timeout_s`",
        Response.HOLD_UNTIL_TARGET,
        Response.HOLD_UNTIL_TARGET,
        "nothing; logged, and flagged in the state",
        0.5,
        "not needed: the next target",
    ),
    Trouble.CALLER_DEAD: _land(
        "its process is gone (exception, signal, kill -9), or executes another program", PARENT_S, "—"
    ),
    Trouble.CAMERA_DEAD: Rule(
        "a camera is gone; its newest image is older than 0.8 s; or, on a busy computer, has been older than 0.5 s for "
        "3 s",
        Response.HOLD_UNTIL_TARGET,
        Response.HOLD_UNTIL_TARGET,
        "StaleStateError that names the camera; arms hold, and land when the caller disconnects",
        1.0,
        _RECONNECT,
    ),
    Trouble.CONTROL_DEAD: _land("its process is gone (kill -9)", 0.1),
    Trouble.CONTROL_HUNG: _land(f"no tick for {HUNG_S} s; the stand-by ends it first", 0.3),
    Trouble.STAND_BY_DEAD: _go_on(
        "its process is gone", "a warning in the log", 1.0, f"{_RECONNECT} to have one again"
    ),
    Trouble.LOOP_SLOW: _go_on(
        "a fifth of the last second's ticks late",
        "a warning in the log; states older than `max_state_age_s` are refused",
        1.0,
    ),
    Trouble.INTERNAL_ERROR: _hold(
        "an exception in the loop", TICK_S, "MotorError with the exception; the trace is in the log", _RECONNECT
    ),
    Trouble.GRIPPER: _hold(
        "the search or the check of the stops fails", 20.0, "MotorError; at bring-up once the arms have landed"
    ),
    Trouble.OBSTRUCTED: Rule(
        "the arm does not follow its landing for 0.5 s; it goes round, over the top, before it holds",
        Response.HOLD,
        Response.GO_ON,
        "a warning in the log that names the joint, an error once it holds",
        1.0,
        "let go of the arm, free the way or take the load, and keep clear: it tries again every 3 s. After three "
        "barred ways it sinks slowly where it is, and cuts torque when it lies or hangs still",
    ),
    Trouble.WEIGHT: _hold(
        "the torque that holds an arm before it floats is over 20 % (and 2 % of the motor's range) off the model's",
        3.0,
        "MotorError that names joints, torques and what to check; at bring-up once the arms have landed. From `float` "
        "and `disable_torque` LifeCycleError, and the arm goes on holding",
    ),
    Trouble.RUNAWAY: _hold(
        "a floating joint is faster than `float_speed_rad_s` in one direction for 0.25 s (0.6 s where a hand pushes), "
        "though it is damped. It is held at once. It is a fault if then its torque is not the model's, or neither the "
        "damping's power nor the trigger shows a hand; else a pause, and it floats again. During an emergency stop and "
        "while an arm is guided by hand it is always a fault",
        3.0,
        "in a pause nothing, a warning in the log; else MotorError that names the joint and what to check",
    ),
    Trouble.LEADER_LOST: Rule(
        "the leader's state is older than 0.03 s, or tells no target: a motor, its process or its link is lost",
        Response.HOLD_UNTIL_TARGET,
        Response.HOLD_UNTIL_TARGET,
        "nothing of the follower, which brakes at its acceleration limit; of the leader as its own row says",
        0.05,
        "not needed: the next target, or the leader's next state",
    ),
    Trouble.FOLLOWER_LOST: _go_on(
        "the follower's state is older than 0.03 s, or it neither holds nor tracks",
        "a warning once; the leader floats without force, and its gate waits. Of the follower as its own row says",
        0.05,
        "not needed: it is led again once it holds or tracks",
    ),
    Trouble.STEERING_STALLED: _hold(
        "a base's steering motor turns with less than a fifth of the commanded rate for 0.3 s",
        0.4,
        "MotorError that names the motor; the base brakes and holds at velocity 0",
    ),
    Trouble.BASE_BLOCKED: _hold(
        "a base's wheel turns with less than half of the commanded rate, above 0.05 m/s, for 0.5 s: it pushes against "
        "something, or a wheel is lifted or blocked",
        0.6,
        "MotorError that names the wheels; the base brakes and holds at velocity 0",
    ),
    Trouble.RAIL_SILENT: _hold(
        f"switches and brake of a base's rail have not been read for {RAIL_SILENT_S} s",
        0.15,
        f"{_RAIL_ERROR}; while the brake cannot be engaged, torque is not cut, even after the caller has gone",
    ),
    Trouble.RAIL_CABLE: _hold(
        "both switches read as triggered for 20 ms: an open wire reads so",
        0.05,
        f"{_RAIL_ERROR}; at bring-up nothing is energised",
    ),
    Trouble.RAIL_SWITCH: _hold(
        "a switch reads as triggered 30 mm or more from its end, or not 10 mm behind it, for 20 ms",
        0.05,
        _RAIL_ERROR,
    ),
    Trouble.RAIL_BRAKE: _hold(
        "the brake's output is not confirmed for 0.5 s; or the carriage moves by 1 mm while it grips",
        0.6,
        f"{_RAIL_ERROR}; a brake that slips: the motor holds the carriage again, and torque is not cut until the base "
        "is re-armed, even after the caller has gone",
    ),
    Trouble.RAIL_BLOCKED: _hold("the carriage is 0.5 rad of its motor behind its plan", 0.2, _RAIL_ERROR),
    Trouble.RAIL_HOMING: _hold(
        "a switch is not found within 30 s, stays triggered away from its end, or the travel is not the rail's",
        31.0,
        _RAIL_ERROR,
    ),
}
