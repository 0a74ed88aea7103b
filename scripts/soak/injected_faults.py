"""Table of the faults that tests and soak inject: the injection, the modes, and the resulting trouble.

`MATRIX` lists the faults injected by tests/control/test_fault_matrix.py, `ELSEWHERE` the tests that cause other
troubles, and `RANDOM` the random faults of the soak. Each trouble of `state.faults` is in `MATRIX` or `ELSEWHERE`.
"""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from lerobot_robot_yam.state.faults import FAULT_TROUBLE, Trouble

FOLLOWERS = LEFT, RIGHT = ("follower_left", "follower_right")
LEADERS = LEADER, _ = ("leader_left", "leader_right")
CHANNELS = FOLLOWERS + LEADERS
MOTOR = "joint_3"
_ALWAYS, _MOVING = ("bring_up", "hold", "track", "land"), ("hold", "track", "land")
_HOT = {"rate_c_per_s": 0.1, "from_c": 96.0}


@dataclass(frozen=True)
class Injected:
    """A fault of the rig that causes one trouble.

    Attributes:
        kind, value, details: arguments of `RigOperations.fault`.
        phases: phases of the arm in which the fault is injected.
        lockstep: the phase that every test run checks; the long tier checks all phases.
        refused: pattern in the error of a start with this fault; None if the fault does not prevent a start.
        channel: channel of the affected arm.
        motor: affected motor; None for the whole channel.
        names: what an error must name; by default the motor or the channel.
    """

    trouble: Trouble
    kind: str
    value: Any = True
    phases: tuple[str, ...] = _ALWAYS
    lockstep: str = ""
    refused: str | None = ""
    channel: str = LEFT
    motor: str | None = MOTOR
    names: str = ""
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def named(self) -> str:
        """What an error must name."""
        return self.names or self.motor or self.channel

    def inject(self, rig: RigOperations) -> None:
        """Inject this fault."""
        rig.fault(self.channel, self.motor, self.kind, self.value, **self.details)


_CODES_IN_LOCKSTEP = {Fault.OVER_CURRENT: "track", Fault.COMMUNICATION_LOST: "bring_up"}
_CODES = {  # all fault codes of a motor
    code.name.lower().replace("_", "-"): Injected(
        FAULT_TROUBLE[code],
        "nibble",
        int(code),
        lockstep=_CODES_IN_LOCKSTEP.get(code, ""),
        refused=f"cannot enable.*0x{code:X}",
        details={"sticky": True},
    )
    for code in map(Fault, FAULT_TROUBLE)
    if code is not Fault.DISABLED
}
MATRIX = _CODES | {
    "disabled": Injected(Trouble.DISABLED, "nibble", 0, _MOVING),
    "motor-silent": Injected(Trouble.MOTOR_SILENT, "silent", lockstep="hold", refused="no answer from 1 of 7"),
    "cable-out": Injected(Trouble.BUS_SILENT, "cable_out", lockstep="track", refused="no answer from 7", motor=None),
    "bus-off": Injected(Trouble.BUS_OFF, "bus_off", refused="buffer space|no answer", motor=None),
    "link-down": Injected(Trouble.LINK_DOWN, "link_down", refused="Network is down", motor=None),
    "adapter-gone": Injected(
        Trouble.ADAPTER_GONE, "adapter_gone", lockstep="land", refused="no such device", motor=None
    ),
    "reply-lost": Injected(Trouble.REPLY_LOST, "drop_next", 1, _MOVING),
    "burst-lost": Injected(Trouble.REPLIES_LOST, "drop_next", 12, _MOVING),
    "wrong-id": Injected(Trouble.WRONG_ID, "wrong_id", 0x42, ("bring_up", "track"), "bring_up", "0x42"),
    "duplicate-id": Injected(
        Trouble.DUPLICATE_ID, "duplicate", True, ("bring_up", "hold", "track"), "bring_up", "more than one answer"
    ),
    "second-arm": Injected(
        Trouble.DUPLICATE_ID,
        "second_arm",
        phases=("bring_up", "hold", "track"),
        refused="more than one answer",
        motor=None,
        names=MOTOR,
    ),
    "leap": Injected(Trouble.IMPLAUSIBLE, "reading", {"position_rad": 2.0}, _MOVING, "track"),
    "turn": Injected(Trouble.IMPLAUSIBLE, "reading", {"position_rad": -2 * math.pi}, _MOVING),
    # A reply that contains another motor's number counts as missing.
    "garbled": Injected(Trouble.IMPLAUSIBLE, "corrupt_rate", 0.3, _MOVING),
    "foreign-driver": Injected(
        Trouble.FOREIGN_DRIVER,
        "foreign",
        {"id": 3, "rate_hz": 100.0},
        ("bring_up", "hold"),
        "hold",
        "already being driven",
        motor=None,
    ),
    "handle-silent": Injected(
        Trouble.ENCODER_SILENT,
        "handle_silent",
        True,
        ("bring_up", "hold", "land"),
        "hold",
        "handle",
        channel=LEADER,
        motor=None,
    ),
    "warm": Injected(Trouble.WARM, "temperature_ramp", _HOT | {"from_c": 88.0}, ("bring_up", "track"), refused=None),
    "hot": Injected(Trouble.HOT, "temperature_ramp", _HOT, ("hold", "track"), "hold"),
}
ELSEWHERE = {  # trouble → test that causes it
    Trouble.CONTROL_DEAD: "tests/control/process/test_stand_by.py",
    Trouble.CONTROL_HUNG: "tests/control/process/test_stand_by.py",
    Trouble.STAND_BY_DEAD: "tests/control/process/test_stand_by.py",
    Trouble.CALLER_DEAD: "tests/session/test_arm_session.py",
    Trouble.CALLER_STALE: "tests/control/test_two_arms.py",
    Trouble.EMERGENCY_STOP: "tests/control/test_floating.py",
    Trouble.EFFORT: "tests/control/test_two_arms.py",
    Trouble.OBSTRUCTED: "tests/control/test_landing.py",
    Trouble.CAMERA_DEAD: "tests/cli/test_interrupted_recording.py",
    Trouble.INTERNAL_ERROR: "tests/session/test_arm_session.py",
    Trouble.LOOP_SLOW: "tests/session/test_step_runner.py",
    Trouble.GRIPPER: "tests/control/gripper/test_gripper_stops.py",
    Trouble.WEIGHT: "tests/control/test_floating.py",
    Trouble.RUNAWAY: "tests/control/test_floating.py",
    Trouble.LEADER_LOST: "tests/control/teleop/test_lost_leader.py",
    Trouble.FOLLOWER_LOST: "tests/control/teleop/test_lead.py",
    Trouble.STEERING_STALLED: "tests/mobile/test_yam_base.py",
    Trouble.BASE_BLOCKED: "tests/mobile/test_yam_base.py",
    Trouble.RAIL_SILENT: "tests/mobile/test_rail_faults.py",
    Trouble.RAIL_CABLE: "tests/mobile/test_rail_faults.py",
    Trouble.RAIL_SWITCH: "tests/mobile/test_rail_faults.py",
    Trouble.RAIL_BRAKE: "tests/mobile/test_rail.py",
    Trouble.RAIL_BLOCKED: "tests/mobile/test_rail_faults.py",
    Trouble.RAIL_HOMING: "tests/mobile/test_rail.py",
}


@dataclass(frozen=True)
class Kind:
    """One kind of random fault in the soak.

    Attributes:
        gap_s: mean interval between two faults of this kind, s.
        draw: draws channel, motor, value and seconds of the next fault: fields of `schedule.Injection`.
        rig: kind of the rig's fault; empty for other faults, which `Injector` implements.
        usual: value that ends the rig's fault.
        details: details of the rig's fault.
        explains_all: whether the fault can cause any trouble, not only those that `MATRIX` lists for this fault.
        also: additional troubles that the fault explains.
        cuts: whether the fault keeps commands from motors.
    """

    gap_s: float
    draw: Callable[[random.Random], dict[str, Any]]
    rig: str = ""
    usual: Any = False
    details: dict[str, Any] = field(default_factory=dict)
    explains_all: bool = False
    also: frozenset[Trouble] = frozenset()
    cuts: bool = False

    @property
    def troubles(self) -> frozenset[Trouble]:
        """Troubles that the fault can cause."""
        if self.explains_all or self.cuts:
            return frozenset(Trouble)
        return self.also | {row.trouble for row in MATRIX.values() if row.kind == self.rig}


_JOINTS = load_arm("yam").joint_count
_BEYOND_RAD = 0.8  # more than a motor can turn within the four replies after which its readings are rejected
_PUSHED = ("link2", "link3", "link4", "gripper")


def _on_motor(rng: random.Random, value: Any = None, seconds: float = 0.0) -> dict[str, Any]:
    channel = rng.choice(CHANNELS)
    names = [f"joint_{joint + 1}" for joint in range(_JOINTS)] + ["gripper"] * (channel in FOLLOWERS)
    return {"channel": channel, "motor": rng.choice(names), "value": value, "seconds": seconds}


def _on_channel(low_s: float, high_s: float) -> Callable[[random.Random], dict[str, Any]]:
    return lambda rng: {"channel": rng.choice(CHANNELS), "seconds": rng.uniform(low_s, high_s)}


def _offset(rng: random.Random, low: float, high: float) -> float:
    return round(rng.choice((-1.0, 1.0)) * rng.uniform(low, high), 3)


def _push(rng: random.Random) -> dict[str, Any]:
    force = [round(rng.uniform(-40.0, 40.0), 1) for _ in range(3)]
    place = {"channel": rng.choice(FOLLOWERS), "motor": rng.choice(_PUSHED)}
    return place | {"value": force, "seconds": rng.uniform(0.1, 0.5)}


def _glitch(rng: random.Random) -> dict[str, Any]:
    """Return fewer false replies than trigger a fault, with errors larger than a possible motion between replies."""
    value = {"position_rad": _offset(rng, _BEYOND_RAD, 13.0), "answers": rng.randint(1, 3)}
    if rng.random() < 0.5:
        value |= {"velocity_rad_s": _offset(rng, 0.0, 30.0), "torque_nm": _offset(rng, 0.0, 30.0)}
    return _on_motor(rng, value)


def _lie(rng: random.Random) -> dict[str, Any]:
    turn = rng.choice((0.0, 0.0, 2 * math.pi))  # a miscounted turn, or a random offset
    value = {"position_rad": math.copysign(turn, rng.uniform(-1, 1)) if turn else _offset(rng, _BEYOND_RAD, 9.0)}
    return _on_motor(rng, value, rng.uniform(0.1, 1.0))


def _drift(rng: random.Random) -> dict[str, Any]:
    """Return a reading that creeps, freezes or is scaled, which soon is a fault or harmless."""
    value = rng.choice(
        [{"drift_rad": _offset(rng, 0.001, 0.03)}, {"freeze": True}, {"scale": [rng.uniform(0.5, 1.5), 1.0]}]
    )
    return _on_motor(rng, value, rng.uniform(0.1, 1.0))


def _garbled(rng: random.Random) -> dict[str, Any]:
    return _on_channel(0.2, 1.0)(rng) | {"value": round(rng.uniform(0.1, 0.5), 2)}


def _slow_adapter(rng: random.Random) -> dict[str, Any]:
    return _on_channel(0.5, 3.0)(rng) | {"value": round(rng.uniform(0.002, 0.02), 4)}


def _held_back(rng: random.Random) -> dict[str, Any]:
    value = {"seconds": round(rng.uniform(0.02, 0.08), 3), "every_s": round(rng.uniform(0.2, 0.5), 3)}
    return _on_channel(0.5, 3.0)(rng) | {"value": value}


def _hot(rng: random.Random) -> dict[str, Any]:
    return {"channel": rng.choice(CHANNELS), "motor": "joint_2", "value": _HOT, "seconds": 2.0}


_CODE = sorted(map(int, FAULT_TROUBLE))  # every fault code with which a motor switches off
_TWO_ARMS = frozenset({Trouble.IMPLAUSIBLE, Trouble.DISABLED})  # the second arm's limp motors reply for ours
EVEN = "motor_fault"
"""Kind that occurs at even intervals."""
RANDOM = {
    EVEN: Kind(30.0, lambda rng: _on_motor(rng, rng.choice(_CODE)), "nibble", explains_all=True),
    # Too short for a silence (0.15 s), even if ticks take three times as long as they should.
    "lost_replies": Kind(2.0, lambda rng: _on_motor(rng, rng.randint(1, 8)), "drop_next"),
    "motor_silent": Kind(75.0, lambda rng: _on_motor(rng, seconds=rng.uniform(0.03, 1.5)), "silent", cuts=True),
    "reading_glitch": Kind(4.0, _glitch, "reading"),
    "reading_lies": Kind(60.0, _lie, "reading"),
    "reading_drifts": Kind(90.0, _drift, "reading"),
    "garbled": Kind(90.0, _garbled, "corrupt_rate", 0.0, {"all_bytes": True}),
    "second_arm": Kind(150.0, _on_channel(0.2, 1.5), "second_arm", also=_TWO_ARMS),
    "slow_adapter": Kind(60.0, _slow_adapter, "latency_s", 0.0),
    "held_back": Kind(40.0, _held_back, "hold_back"),
    "motor_hot": Kind(240.0, _hot, "temperature_ramp", explains_all=True),
    "cable_out_briefly": Kind(50.0, _on_channel(0.01, 0.28), "cable_out", cuts=True),
    "cable_out": Kind(200.0, _on_channel(0.5, 2.0), "cable_out", cuts=True),
    "link_down": Kind(150.0, _on_channel(0.02, 0.28), "link_down", cuts=True),
    "bus_off": Kind(300.0, _on_channel(0.02, 0.28), "bus_off", cuts=True),
    "adapter_gone": Kind(300.0, _on_channel(0.1, 1.0), "adapter_gone", cuts=True),
    "handle_silent": Kind(
        40.0, lambda rng: {"channel": rng.choice(LEADERS), "seconds": rng.uniform(0.1, 2.0)}, "handle_silent"
    ),
    "caller_stall": Kind(20.0, lambda rng: {"seconds": rng.uniform(0.1, 3.0)}),
    "kill_control": Kind(120.0, lambda rng: {"channel": rng.choice(CHANNELS)}, explains_all=True),
    "stop_control": Kind(150.0, lambda rng: {"channel": rng.choice(CHANNELS)}, explains_all=True),
    "emergency_stop": Kind(60.0, lambda rng: {"seconds": rng.uniform(0.2, 3.0)}),
    "push": Kind(12.0, _push),
    "far_action": Kind(6.0, lambda rng: {"value": round(rng.uniform(-8.0, 8.0), 2)}),
}
