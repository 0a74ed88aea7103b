"""kill -9 of the control process: the stand-by has the arms before their motors' watchdogs act, and lands them."""

import contextlib
import logging
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.arm.estop import EmergencyStop
from lerobot_robot_yam.arm.hardware import Hardware
from lerobot_robot_yam.arm.landing import LANDING_SPEED_RAD_S
from lerobot_robot_yam.arm.lifecycle import Mode
from lerobot_robot_yam.arm.policy import stale_overshoot_rad_s
from lerobot_robot_yam.arm.session import ArmSession
from lerobot_robot_yam.arm.state import STATE_DTYPE, channel_key, command_path, lock_path, state_path
from lerobot_robot_yam.errors import MotorError, StaleStateError, YamError
from lerobot_robot_yam.rig.control import running_rig, runs
from lerobot_robot_yam.shared_block import SharedBlock

from ..landed import MOST_M, moved_after_cut_m
from ..stillness import Stillness
from .rigged import sim_config, track

pytestmark = pytest.mark.alone

logger = logging.getLogger(__name__)

WATCHDOG_MOST_S = 0.25  # what the machine has to lose before a motor's 0.4 s can be no fault of ours
MOST_LOST_S = 0.1  # of the second that a landing may take beyond its way
STRETCHED = [0.1, 1.3, 1.2, -0.2, 0.0, 0.0]


def start(rig, *channels):
    session = ArmSession([sim_config(rig, channel, speed_limit_rad_s=3.0) for channel in channels])
    session.start()
    return session


def stretch(session, seconds, *channels):
    track(session, dict.fromkeys(channels, STRETCHED), seconds)


def control_pid(session):
    return session._runner._child.pid


def stand_by_pid(session):
    (pid,) = open(f"/proc/{control_pid(session)}/task/{control_pid(session)}/children").read().split()
    return int(pid)


def faults(rig, since):
    return [event for event in rig.events(since) if event["kind"] == "motor_fault"]


def last_event(rig):
    events = rig.events()
    return events[-1]["number"] + 1 if events else 0


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.long)])
def test_the_stand_by_lands_both_arms(rig, number, caplog):
    channels = ("follower_left", "follower_right")
    session = start(rig, *channels)
    try:
        stretch(session, 1.5, *channels)
        since, before = last_event(rig), rig.state()["arms"]["follower_left"]["grasp_site"]["pos"][2]
        os.kill(control_pid(session), number)
        killed = time.monotonic()
        lowest = before
        with pytest.raises((MotorError, StaleStateError)):  # the caller is told, whatever it does next
            while time.monotonic() < killed + 1.0:
                session["follower_left"].observe()
                lowest = min(lowest, rig.state()["arms"]["follower_left"]["grasp_site"]["pos"][2])
        assert before - lowest < 0.005
        deadline = time.monotonic() + 1.0
        while session["follower_left"].mode() is not Mode.LAND:
            assert time.monotonic() < deadline
            time.sleep(0.005)
        with pytest.raises(MotorError, match="control process has died"):
            session["follower_left"].observe()
    finally:
        session.stop()
    assert not faults(rig, since)  # no motor has missed its commands for long
    arms = rig.state()["arms"]
    assert not any(m["enabled"] for c in channels for m in arms[c]["motors"].values())
    again = start(rig, "follower_left")  # connecting again is all that it takes
    again.stop()


def test_a_fault_during_an_emergency_stop_does_not_end_the_landing_for_good(rig):
    """Nobody is left who could ask for it again."""
    channel, stop = "follower_left", EmergencyStop()
    session = start(rig, channel)
    try:
        stretch(session, 1.5, channel)
        os.kill(control_pid(session), signal.SIGKILL)
        wait_mode(session[channel], Mode.LAND)
        stop.latch("a test")
        wait_mode(session[channel], Mode.STOPPED)
        time.sleep(1.5)
        assert "control process has died" in session[channel].observe().message  # that remains what is told
        rig.fault(channel, "joint_1", "nibble", 0xE)
        wait_mode(session[channel], Mode.FAULT)
        stop.release()
        wait_mode(session[channel], Mode.OFF, 10.0)
    finally:
        stop.release()
        session.stop()
    assert not any(motor["enabled"] for motor in rig.state()["arms"][channel]["motors"].values())


def wait_mode(arm, mode, timeout_s=1.0):
    deadline = time.monotonic() + timeout_s
    while arm.mode() is not mode:
        assert time.monotonic() < deadline, f"{arm.mode()} instead of {mode}"
        time.sleep(0.005)


def test_killed_in_the_middle_of_a_write(rig):
    """The state that it leaves can never be read; nobody waits for it."""
    channel = "follower_left"
    session = start(rig, channel)
    path, pid = state_path(channel_key("yam_sim", channel, rig.name)), control_pid(session)
    block = SharedBlock(path, STATE_DTYPE, create=False)
    try:
        stretch(session, 1.5, channel)
        since = last_event(rig)
        os.kill(pid, signal.SIGSTOP)
        os.waitid(os.P_PID, pid, os.WSTOPPED | os.WNOWAIT)
        with open(path, "r+b", buffering=0) as file:
            os.pwrite(file.fileno(), struct.pack("<Q", block.sequence() | 1), 8)
            os.pwrite(file.fileno(), bytes(32), 64)
        os.kill(pid, signal.SIGKILL)
        killed = time.monotonic()
        while (record := block.glance()) is None or record["mode"] != Mode.LAND:
            assert time.monotonic() < killed + 1.0
        with pytest.raises(MotorError, match="control process has died"):
            session[channel].observe()
    finally:
        block.close()
        session.stop()
    assert not faults(rig, since)


@pytest.mark.parametrize("tries", [3, pytest.param(40, marks=pytest.mark.long)])
def test_killed_while_the_arms_come_up(rig, tries):
    """Those that are up have torque, and nobody else to command them."""
    channels, rng = ("follower_left", "follower_right"), np.random.default_rng(3)
    session = ArmSession([sim_config(rig, channel) for channel in channels])
    state = state_path(channel_key("yam_sim", channels[0], rig.name))

    def begin():
        with contextlib.suppress(YamError):
            session.start()

    def on():
        arms = rig.state()["arms"]
        return sum(m["enabled"] for channel in channels for m in arms[channel]["motors"].values())

    for _ in range(tries):
        since, deadline = last_event(rig), time.monotonic() + 20.0
        starting = threading.Thread(target=begin)
        starting.start()
        while not on():
            assert time.monotonic() < deadline
        with contextlib.closing(SharedBlock(state, STATE_DTYPE, create=False)) as block:
            pid = int(block.read()["owner_pid"])
        time.sleep(rng.uniform(0.0, 0.12))
        logger.info("%d motors are on", on())
        os.kill(pid, signal.SIGKILL)
        starting.join()
        while on():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        session.stop()
        assert not faults(rig, since)


def test_killed_after_its_files_were_removed(rig):
    """By systemd's RemoveIPC, when the user of a detached session logs out."""
    channel = "follower_left"
    session = start(rig, channel)
    try:
        stretch(session, 1.5, channel)
        since, key = last_event(rig), channel_key("yam_sim", channel, rig.name)
        for path in (state_path(key), command_path(key), lock_path(key)):
            path.unlink()
        time.sleep(0.3)
        session[channel].observe()  # and nothing has happened yet
        os.kill(control_pid(session), signal.SIGKILL)
        deadline = time.monotonic() + 10.0
        while any(motor["enabled"] for motor in rig.state()["arms"][channel]["motors"].values()):
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        session.stop()
    assert not faults(rig, since)


def test_without_the_stand_by_the_arm_falls(rig, capfd):
    """What it is there for, and that the test above can fail."""
    session = start(rig, "follower_left")
    stretch(session, 1.5, "follower_left")
    since = last_event(rig)
    os.kill(stand_by_pid(session), signal.SIGKILL)
    time.sleep(0.1)
    session["follower_left"].observe()  # nothing depends on it
    assert "the stand-by has died" in capfd.readouterr().err
    before = rig.state()["arms"]["follower_left"]["grasp_site"]["pos"][2]
    os.kill(control_pid(session), signal.SIGKILL)
    time.sleep(1.0)
    assert rig.state()["arms"]["follower_left"]["grasp_site"]["pos"][2] < before - 0.05
    assert faults(rig, since)
    with pytest.raises(StaleStateError):
        session["follower_left"].observe()
    session.stop()


def test_a_limp_arm_is_left_alone(rig):
    """Killed while nothing is energised: the stand-by must not energise."""
    session = start(rig, "follower_left")
    rig.cut_torque("follower_left")
    time.sleep(0.3)
    os.kill(control_pid(session), signal.SIGKILL)
    time.sleep(0.3)
    assert not any(m["enabled"] for m in rig.state()["arms"]["follower_left"]["motors"].values())
    session.stop()


def test_it_ends_with_its_control_process(rig):
    session = start(rig, "follower_left")
    pid = stand_by_pid(session)
    session.stop()
    deadline = time.monotonic() + 2.0
    while runs(pid):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def wait_still(rig, channel):
    """Until the arm rests where it was sent, so that what moves afterwards is the landing."""
    deadline = time.monotonic() + 5.0
    while max(np.abs(rig.state()["arms"][channel]["dq"])) > 0.02:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def landing_after_kill(rig, channel, pid, rng):
    """Kill at a random tick; returns drop of the tip (m), time until landing began (s), greatest speed, s over time.

    None when the world or the whole machine stood still meanwhile: then nothing was measured.
    """
    machine = Stillness(Path(os.environ["YAM_TEST_STILLNESS"]))
    block = SharedBlock(state_path(channel_key("yam_sim", channel, rig.name)), STATE_DTYPE, create=False)
    try:
        wait_still(rig, channel)
        time.sleep(rng.uniform(0, 0.1))
        since, slips, lost_s = last_event(rig), rig.stats()["slips"], machine.lost_s()
        rig.watch_start(channel)
        hardware = Hardware(sim_config(rig, channel))
        travel = np.abs(block.read()["setpoint"][: hardware.joints] - hardware.rest_q)
        os.kill(pid, signal.SIGKILL)
        begin = time.monotonic()
        while block.read()["mode"] != Mode.LAND:
            assert time.monotonic() < begin + 1.0
        began_s = time.monotonic() - begin
        tip_drop = rig.watch(channel)["max_tcp_drop_m"]  # until the landing began
        while block.read()["mode"] != Mode.OFF:
            assert time.monotonic() < begin + 20.0
            time.sleep(0.005)
        took_s = time.monotonic() - begin
    finally:
        block.close()
    seen = rig.watch(channel)
    assert not faults(rig, since) or machine.lost_s() - lost_s > WATCHDOG_MOST_S
    if rig.stats()["slips"] > slips or machine.lost_s() - lost_s > MOST_LOST_S:
        return None
    lowering = 0.35  # the wrist is raised while folding and lowered afterwards
    over_s = took_s - began_s - (travel[1:].max() + lowering) / LANDING_SPEED_RAD_S
    return tip_drop, began_s, max(seen["max_speed_rad_s"]), over_s


def killed_control_process(rig, channel, rng):
    session = start(rig, channel)
    try:
        stretch(session, 1.5, channel)
        return landing_after_kill(rig, channel, control_pid(session), rng)
    finally:
        session.stop()


CALLER = """
import sys
from tests.arm import test_stand_by as t
from lerobot_robot_yam.rig.control import RigControl
with RigControl(sys.argv[1]) as rig:
    session = t.start(rig, sys.argv[2])
    t.stretch(session, 0.9, sys.argv[2])
    print("stretched", flush=True)
    t.stretch(session, 60.0, sys.argv[2])
"""


def killed_caller(rig, channel, rng):
    caller = subprocess.Popen([sys.executable, "-c", CALLER, rig.name, channel], stdout=subprocess.PIPE, text=True)
    try:
        assert caller.stdout.readline() == "stretched\n"
        return landing_after_kill(rig, channel, caller.pid, rng)
    finally:
        caller.kill()
        caller.communicate()


@pytest.mark.parametrize("killed", [killed_control_process, killed_caller])
def test_killed_with_a_stretched_arm(rig, killed):
    check_landing(killed, measured(killed, rig, 1, np.random.default_rng(1)))


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("killed", [killed_control_process, killed_caller])
def test_killed_at_100_random_ticks(killed):
    rng = np.random.default_rng(5)
    with running_rig(arms=["follower_left"]) as rig:
        check_landing(killed, measured(killed, rig, 100, rng))


@pytest.mark.parametrize("tries", [1, pytest.param(30, marks=pytest.mark.long)])
def test_killed_in_motion(rig, tries):
    """It brakes and lands, no faster than on its way but for what the last command adds until somebody acts."""
    channel, rng = "follower_left", np.random.default_rng(7)
    limits = Hardware(sim_config(rig, channel)).speed_limit[:6]
    for _ in range(tries):
        session = ArmSession([sim_config(rig, channel)])
        session.start()
        try:
            stretch(session, 1.5, channel)
            track(session, {channel: [-0.8, 0.9, 1.6, 0.3, 0.4, -0.5]}, rng.uniform(0.05, 0.6))
            since, killed = last_event(rig), time.monotonic()
            rig.watch_start(channel)
            os.kill(control_pid(session), signal.SIGKILL)
            wait_mode(session[channel], Mode.LAND)
            began_s = time.monotonic() - killed
            wait_mode(session[channel], Mode.OFF, 15.0)
        finally:
            session.stop()
        seen = rig.watch(channel)
        assert not faults(rig, since) and began_s <= 0.1
        late_s = np.maximum(np.array(seen["max_command_age_s"][:6]) - 0.008, 0.0)
        allowed = 1.3 * limits + [stale_overshoot_rad_s(float(age_s)) for age_s in late_s]
        assert np.all(seen["max_speed_rad_s"][:6] < allowed), seen
        assert moved_after_cut_m(rig, channel) < MOST_M


def measured(killed, rig, count, rng):
    """So many deaths during which nothing stood still."""
    rows, spoilt = [], 0
    while len(rows) < count:
        row = killed(rig, "follower_left", rng)
        if row is not None:
            rows.append(row)
            continue
        spoilt += 1
        logger.info("%s: number %d was spoilt, something stood still", killed.__name__, len(rows) + spoilt)
        assert spoilt <= 2 + count // 5, "the machine is too busy for this test"
    return rows


def check_landing(killed, rows):
    drop, began, speed, over = np.max(rows, axis=0)
    for row in sorted(rows, key=lambda row: row[2])[-3:]:
        logger.info("among the fastest: drop %.4f m, began after %.3f s, %.3f rad/s, %+.3f s", *row)
    logger.info(
        f"{killed.__name__} x {len(rows)}: drop {drop * 1e3:.2f} mm, landing begins after {began * 1e3:.0f} ms, "
        f"{speed:.2f} rad/s, {over:+.2f} s"
    )
    assert drop <= 0.005 and began <= 0.1 and speed <= LANDING_SPEED_RAD_S and over <= 1.0
