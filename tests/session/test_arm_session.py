"""The shipped loop and driver on the virtual rig, over CAN frames, as a process and as a thread."""

import dataclasses
import json
import logging
import os
import signal
import subprocess
import sys
import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.errors import (
    ActionError,
    BusError,
    ConfigError,
    LifeCycleError,
    MotorError,
    YamError,
)
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from tests.support.rigged import abandon, energise, rig_of, sim_config
from tests.support.tiers import spread

TICK_S = 0.004
ISOLATIONS = ["process", "thread"]
in_a_process = pytest.mark.parametrize("isolation", ["process"])


@pytest.fixture(params=["lockstep", *(pytest.param(kind, marks=pytest.mark.long) for kind in ISOLATIONS)])
def isolation(request):
    """Where the loop runs, of tests that do not say so."""
    return request.param


@pytest.fixture
def rig(isolation):
    arms = ["follower_left", "follower_right"]
    with rig_of("lockstep" if isolation == "lockstep" else "live", arms=arms) as rig:
        yield rig


def arm_config(rig, channel="follower_left", **fields):
    return dataclasses.replace(sim_config(rig, channel, **fields), name=channel.split("_")[1])


def arm_of(rig, isolation, **fields):
    return YamArm(arm_config(rig, **fields), isolation=isolation)


def enabled(rig, channel="follower_left"):
    return [m["enabled"] for m in rig.state()["arms"][channel]["motors"].values()]


@pytest.mark.parametrize("isolation", spread(ISOLATIONS, 0))
def test_an_arm_comes_up_tracks_and_lands(rig, isolation, caplog):
    caplog.set_level(logging.INFO)
    session = ArmSession([arm_config(rig), arm_config(rig, "follower_right")], isolation)
    assert not any(enabled(rig))
    session.start()
    try:
        assert all(enabled(rig)) and all(enabled(rig, "follower_right"))
        goal = np.array([0.3, 0.9, 0.8, -0.4, 0.2, 0.3])
        deadline = time.monotonic() + 2.5
        while time.monotonic() < deadline:
            session["left"].write_target(goal, 0.4)
            session["right"].write_target(goal * [-1, 1, 1, 1, 1, 1], 0.9)
            time.sleep(0.02)
        state = session["left"].observe()
        assert state.mode is Mode.TRACK
        assert np.abs(state.q - goal).max() < 0.02
        assert state.gripper == pytest.approx(0.4, abs=0.02)
        assert session["right"].observe().q[0] == pytest.approx(-0.3, abs=0.02)
        truth = rig.state()["arms"]["follower_left"]
        assert np.abs(np.array(truth["q"]) - state.q).max() < 0.01  # what is said is what is
    finally:
        session.stop()
    assert not any(enabled(rig)) and not any(enabled(rig, "follower_right"))
    session.stop()  # idempotent
    if isolation == "thread":
        assert any("period p50" in record.message for record in caplog.records)


@pytest.mark.long
def test_set_point_steps_stay_within_speed_limit_times_tick(rig, isolation):
    with arm_of(rig, isolation, speed_limit_rad_s=1.0) as arm:
        for _ in range(20):
            arm.command([1.0, 1.2, 1.2, 0.5, 0.5, 0.5])
            arm.clock.sleep(0.03)
        seen = []
        begin = arm.clock.now()
        while arm.clock.now() - begin < 1.0:
            arm.command([-1.0, 0.2, 0.2, -0.5, -0.5, -0.5])
            state = arm.observe()
            seen.append((state.stamp_s, state.setpoint_q, state.limited))
            arm.clock.sleep(0.005)
        speeds = [
            np.abs(b[1] - a[1]).max() / (b[0] - a[0]) for a, b in zip(seen, seen[8:], strict=False) if b[0] > a[0]
        ]
        assert max(speeds) < 1.25  # 1.0 rad/s over 8 samples whose stamps are a tick apart
        assert max(speeds) > 0.8
        assert any(Limited.SPEED in limited for *_, limited in seen)


@in_a_process
def test_who_looks_just_before_a_new_state_gets_the_new_one(rig, isolation):
    newer, tries = 0, 20
    with arm_of(rig, isolation, rate_hz=100.0) as arm:
        port = arm._session["left"]
        for _ in range(tries):
            before_s = port.published().published_s
            time.sleep(max(0.0, before_s + 0.0089 - time.monotonic()))
            newer += arm.observe().stamp_s > before_s
    assert newer > tries / 2


@pytest.mark.long
@in_a_process
def test_who_looks_after_a_lost_reply_gets_the_next_one(rig, isolation):
    newer, tries = 0, 12
    with arm_of(rig, isolation, rate_hz=100.0) as arm:
        port = arm._session["left"]
        for _ in range(tries):
            time.sleep(0.03)
            rig.fault("follower_left", "joint_2", "drop_next", 1)
            deadline = time.monotonic() + 0.5
            while (before := port.published()).published_s - before.stamp_s < 0.009:  # almost a tick
                if time.monotonic() > deadline:  # the machine was busy in that tick: it has been missed
                    break
                time.sleep(0.0002)
            else:
                newer += arm.observe().stamp_s > before.published_s
    assert newer > tries / 2


def test_a_caller_that_falls_silent_leaves_the_arm_holding(rig, isolation):
    with arm_of(rig, isolation, command_timeout_s=0.2) as arm:
        arm.move_to([0.2, 0.8, 0.8, 0, 0, 0])
        arm.command([1.5, 0.8, 0.8, 0, 0, 0])
        arm.clock.sleep(0.6)
        state = arm.observe()
        assert state.mode is Mode.HOLD
        assert Limited.COMMAND_TIMEOUT in state.limited
        stopped_at = state.setpoint_q[0]
        assert 0.25 < stopped_at < 0.7  # went on for 0.2 s at 1.5 rad/s at most, then braked
        arm.clock.sleep(0.3)
        assert arm.observe().setpoint_q[0] == pytest.approx(stopped_at, abs=1e-3)
        arm.command([1.5, 0.8, 0.8, 0, 0, 0])  # it resumes without a jump
        arm.clock.sleep(0.02)
        assert abs(arm.observe().setpoint_q[0] - stopped_at) < 0.05


@pytest.mark.long
def test_floating_carries_the_weight_and_holding_takes_over_where_the_arm_is(rig, isolation):
    with arm_of(rig, isolation) as arm:
        arm.move_to([0.0, 1.0, 1.0, 0, 0, 0])
        arm.float()
        arm.clock.sleep(0.5)
        before = arm.observe().q
        arm.clock.sleep(1.0)
        assert np.abs(arm.observe().q - before).max() < 0.03  # does not fall
        rig.push("follower_left", "link6", [0, 12, 0], 0.2)
        arm.clock.sleep(0.8)
        moved = arm.observe().q
        assert abs(moved[0] - before[0]) > 0.05  # and is free to move
        arm.hold()
        arm.clock.sleep(0.3)
        assert np.abs(arm.observe().q - moved).max() < 0.15
        assert arm.observe().mode is Mode.HOLD


@pytest.mark.parametrize("field", ["calibration_path", "identity_path"])
def test_each_arm_has_files_of_its_own(rig, field, tmp_path):
    arms = [
        dataclasses.replace(arm_config(rig, c), **{field: str(tmp_path / "x")})
        for c in ("follower_left", "follower_right")
    ]
    with pytest.raises(ConfigError, match=f"each arm needs a {field} of its own"):
        ArmSession(arms)


BAD_MOTORS = {
    "silent": ({"motor": "joint_4"}, r"follower_right: no answer from 1 of 7 motors: joint_4 \(id 4\)"),
    "duplicate": ({"motor": "joint_2"}, "more than one answer from joint_2"),
    "register TMAX": (
        {"motor": "joint_1", "register": int(Register.TMAX), "value": 10.0},
        "motor joint_1 .* TMAX is 10 instead of 28 Nm",
    ),
    "register TIMEOUT": (
        {"motor": "gripper", "register": int(Register.TIMEOUT), "value": 0},
        "motor gripper .* TIMEOUT is 0 instead of 8000",
    ),
}


@pytest.mark.parametrize("kind", BAD_MOTORS)
def test_one_bad_motor_keeps_both_arms_limp(rig, isolation, kind):
    bad_motor_keeps_both_arms_limp(rig, isolation, kind)


@pytest.mark.parametrize("isolation", spread(ISOLATIONS, 0))
def test_one_silent_motor_keeps_both_arms_limp(rig, isolation):
    bad_motor_keeps_both_arms_limp(rig, isolation, "silent")


def bad_motor_keeps_both_arms_limp(rig, isolation, kind):
    details, message = BAD_MOTORS[kind]
    rig.fault("follower_right", kind=kind.split()[0], **details)
    session = ArmSession([arm_config(rig), arm_config(rig, "follower_right")], isolation)
    with pytest.raises(MotorError, match=message):
        session.start()
    assert not any(enabled(rig)) and not any(enabled(rig, "follower_right"))
    assert not session.running
    rig.clear_faults("follower_right")


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"channel": "follower_middle"}, BusError, "follower_middle.*follower_left"),
        ({"interface": "nosuchcan"}, BusError, "nosuchcan"),
        ({"arm": "yam_max"}, ConfigError, "unknown arm 'yam_max'; did you mean 'yam.*Known: yam, big_yam"),
        ({"gripper": "claw"}, ConfigError, "unknown gripper 'claw'"),
        ({"rate_hz": 900}, ConfigError, "at most 500 Hz"),
        ({"kp": [1.0]}, ConfigError, "kp takes 6 numbers"),
        ({"speed_limit_rad_s": 0.0}, ConfigError, "above zero"),
        ({"estop_button": "top"}, ConfigError, "estop_button.*linear_4310 has none"),
    ],
)
def test_what_does_not_exist_is_refused_by_name(rig, isolation, change, error, message):
    with pytest.raises(error, match=message):
        ArmSession([dataclasses.replace(arm_config(rig), **change)], isolation).start()
    assert not any(enabled(rig))


@pytest.mark.long
def test_a_motor_fault_is_named_and_the_rest_holds(rig, isolation):
    with arm_of(rig, isolation) as arm:
        arm.move_to([0.0, 0.8, 0.8, 0, 0, 0])
        rig.fault("follower_left", "joint_6", "nibble", 0xC)
        with pytest.raises(MotorError, match=r"left \(follower_left\): joint_6 \(id 6\): 0xC coil too hot"):
            for _ in range(100):
                arm.observe()
                arm.clock.sleep(0.01)
        before = rig.state()["arms"]["follower_left"]["q"]
        arm.clock.sleep(0.5)
        after = rig.state()["arms"]["follower_left"]["q"]
        assert np.abs(np.array(after) - before)[:3].max() < 0.01
    assert not any(enabled(rig))


def test_an_error_in_our_own_code_leaves_the_arm_held(caplog):
    """Broken from outside: the laws yield NaN, which no frame can carry."""
    with rig_of("lockstep", arms=["follower_left"]) as own:
        bus = can.Bus(interface="yam_lockstep", channel="follower_left", rig=own.name)
        controller = ArmController(ResolvedArm(arm_config(own)), bus)
        controller.inspect()
        energise(controller)
        for _ in range(400):  # through bring-up to a hold
            controller.actuation.send()
            controller.actuation.chain.collect(own.now() + TICK_S)
            controller.measure(own.now())
            controller.decide(own.now())
            controller.actuation.setpoint.step(own.now(), TICK_S)
            controller.actuation.compute_command(own.now(), TICK_S)
        assert controller.mode is Mode.HOLD
        before = np.array(own.state()["arms"]["follower_left"]["q"])
        controller.actuation.commands[:] = np.nan
        for _ in range(200):
            try:
                controller.actuation.send()
            except ActionError as error:
                controller.faults.fail(error)
            controller.actuation.chain.collect(own.now() + TICK_S)
        assert controller.mode is Mode.FAULT
        assert "internal error, holding" in caplog.text
        after = np.array(own.state()["arms"]["follower_left"]["q"])
        assert all(enabled(own)) and np.abs(after - before).max() < 0.05
        abandon(controller)
        bus.shutdown()


CALLER = """
import json, sys, time
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.session.yam_arm import YamArm
arm = YamArm(ArmConfig(**json.loads(sys.argv[1]))).connect()
arm.move_to([0.0, 1.2, 1.0, 0, 0, 0], speed_rad_s=1.4)
print("up", flush=True)
time.sleep(60)
"""


@in_a_process
@pytest.mark.parametrize("signal_number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_a_dead_caller_leaves_a_landed_arm(rig, signal_number):
    caller = subprocess.Popen(
        [sys.executable, "-c", CALLER, json.dumps(dataclasses.asdict(arm_config(rig)))], stdout=subprocess.PIPE
    )
    assert caller.stdout.readline() == b"up\n"
    os.kill(caller.pid, signal_number)
    caller.wait()
    caller.stdout.close()
    assert all(enabled(rig))
    deadline = time.monotonic() + 15
    while any(enabled(rig)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(enabled(rig))
    before = [rig.state()["arms"]["follower_left"]["grasp_site"]["pos"]]
    time.sleep(0.5)
    after = [rig.state()["arms"]["follower_left"]["grasp_site"]["pos"]]
    assert np.abs(np.array(after) - before).max() < 0.005  # it lies


def test_a_lost_adapter_is_said_and_ends_cleanly(rig, isolation, caplog, capfd):
    arm = arm_of(rig, isolation).connect()
    clock = arm.clock
    rig.fault("follower_left", None, "bus_off")
    with pytest.raises(YamError, match="left"):
        for _ in range(200):
            arm.observe()
            clock.sleep(0.01)
    begin = clock.now()
    arm.close()
    assert clock.now() - begin < 30
    assert "left (follower_left): CAN error frames: 1;" in caplog.text + capfd.readouterr().err


def test_a_session_that_does_not_run_says_so(rig):
    session = ArmSession([arm_config(rig)])
    with pytest.raises(LifeCycleError, match="left: not connected"):
        session["left"]
    with pytest.raises(ConfigError, match="no arm is called 'middle'"):
        session["middle"]
    with pytest.raises(ConfigError, match="different names and channels"):
        ArmSession([arm_config(rig), arm_config(rig)])
