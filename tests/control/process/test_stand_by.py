"""kill -9 of the control process: the stand-by has the arms before their motors' watchdogs act, and lands them."""

import contextlib
import logging
import os
import signal
import struct
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.control.landing.landing_move import LANDING_SPEED_RAD_S
from lerobot_robot_yam.errors import MotorError, StaleStateError, YamError
from lerobot_robot_yam.rig.control import runs
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, lock_path, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from scripts import recorders
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.rigged import sim_config, track
from tests.support.tiers import spread

pytestmark = pytest.mark.alone

logger = logging.getLogger(__name__)

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


@pytest.mark.parametrize("number", spread([signal.SIGKILL, signal.SIGSTOP], 0), ids=["killed", "hung"])
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
    time.sleep(0.5)
    assert all(moved_after_cut_m(rig, channel) < MOST_M for channel in channels)
    again = start(rig, "follower_left")  # connecting again is all that it takes
    again.stop()


@pytest.mark.long
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


@pytest.mark.long
def test_who_takes_over_during_an_emergency_stop_waits_for_its_release(rig, capfd):
    channel, stop = "follower_left", EmergencyStop()
    session = start(rig, channel)
    try:
        stretch(session, 1.5, channel)
        stop.latch("a test")
        wait_mode(session[channel], Mode.STOPPED)
        before = rig.state()["arms"][channel]["grasp_site"]["pos"][2]
        os.kill(control_pid(session), signal.SIGKILL)
        time.sleep(1.0)
        assert session[channel].mode() is Mode.STOPPED
        assert rig.state()["arms"][channel]["grasp_site"]["pos"][2] == pytest.approx(before, abs=0.005)
        stop.release()
        wait_mode(session[channel], Mode.OFF, 10.0)
    finally:
        stop.release()
        session.stop()
    said = capfd.readouterr().err
    assert "taken over within" in said and "bring-up" not in said and "stand-by failed" not in said


@pytest.mark.long
@pytest.mark.parametrize("lie_rad", [0.3, -0.3])
def test_a_motor_that_was_not_believed_is_landed_unseen(rig, lie_rad):
    channel = "follower_left"
    session = start(rig, channel)
    try:
        stretch(session, 1.5, channel)
        rig.fault(channel, "joint_2", "reading", {"position_rad": lie_rad})
        time.sleep(1.0)
        assert session[channel].published().trouble is Trouble.IMPLAUSIBLE
        recorders.truth_start(rig, channel, 30.0)
        os.kill(control_pid(session), signal.SIGKILL)
        wait_mode(session[channel], Mode.OFF, 20.0)
        truth = recorders.truth(rig, channel)
    finally:
        session.stop()
    assert np.abs(truth["dq"][:, 1]).max() < 2 * LANDING_SPEED_RAD_S
    time.sleep(0.5)
    assert moved_after_cut_m(rig, channel) < MOST_M


def wait_mode(arm, mode, timeout_s=1.0):
    deadline = time.monotonic() + timeout_s
    while arm.mode() is not mode:
        assert time.monotonic() < deadline, f"{arm.mode()} instead of {mode}"
        time.sleep(0.005)


def block_in(pid, link):
    """Where a process has mapped the block to which `link` leads."""
    inode = os.stat(link).st_ino
    for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
        addresses, access, _, _, number, *_ = line.split()
        if int(number) == inode and access.startswith("rw"):
            return int(addresses.split("-")[0], 16)
    raise AssertionError("it has no such mapping")


@pytest.mark.long
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
        begin = block_in(pid, os.readlink(path))
        with open(f"/proc/{pid}/mem", "r+b", buffering=0) as memory:  # nobody else can write into it
            os.pwrite(memory.fileno(), struct.pack("<Q", block.sequence() | 1), begin + 8)
            os.pwrite(memory.fileno(), bytes(32), begin + 64)
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


@pytest.mark.long
def test_killed_while_the_arms_come_up(rig):
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

    for _ in range(40):
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


@pytest.mark.long
def test_killed_after_its_files_were_removed(rig):
    """By systemd's RemoveIPC, when the user of a detached session logs out."""
    channel = "follower_left"
    session = start(rig, channel)
    try:
        stretch(session, 1.5, channel)
        since, key = last_event(rig), channel_key("yam_sim", channel, rig.name)
        for path in (state_path(key), lock_path(key)):
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


@pytest.mark.long
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
