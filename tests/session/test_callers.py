"""Callers that execute another program, fork, or copy what stands for their arms."""

import copy
import os
import pickle
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.rig.control import running_rig, runs
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Request
from lerobot_robot_yam.yam_follower import YamFollower, YamFollowerConfig
from tests.control.process.test_stand_by import faults, last_event, start, stretch
from tests.support.rigged import arm_on, lockstep_rig, running_arm, sim_config, track

CHANNEL = "follower_left"
AWAY = [0.2, 1.0, 1.0, -0.3, 0.1, 0.1]

rig = lockstep_rig(CHANNEL)
session = running_arm(CHANNEL)

CALLER = """
import os, sys, time
from tests.control.process import test_stand_by as t
from lerobot_robot_yam.rig.control import RigControl
with RigControl(sys.argv[1]) as rig:
    session = t.start(rig, "follower_left")
    t.stretch(session, 1.5, "follower_left")
child = os.fork()
if child == 0:
    time.sleep(60)  # it was to hold nothing of its parent's
print(child, flush=True)
os.execvp("sleep", ["sleep", "60"])
"""


def enabled(rig):
    return any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())


@pytest.mark.long
@pytest.mark.alone
def test_a_caller_that_executes_another_program_lands_its_arms():
    with running_rig(arms=[CHANNEL]) as live:
        caller = subprocess.Popen([sys.executable, "-c", CALLER, live.name], stdout=subprocess.PIPE, text=True)
        child = 0
        try:
            child = int(caller.stdout.readline())
            since, deadline = last_event(live), time.monotonic() + 15.0
            while enabled(live):
                assert time.monotonic() < deadline, "it is still energised"
                time.sleep(0.05)
            assert caller.poll() is None and runs(child)
            assert not faults(live, since)
        finally:
            caller.kill()
            if child:
                os.kill(child, signal.SIGKILL)  # it has the pipe, too
            caller.communicate()


@pytest.mark.long
@pytest.mark.alone
def test_a_forked_child_that_ends_its_session_lands_nothing_and_waits_for_nothing():
    with running_rig(arms=[CHANNEL]) as live:
        session = start(live, CHANNEL)
        try:
            stretch(session, 1.5, CHANNEL)
            begin = time.monotonic()
            assert in_a_child(session.stop) == "False"  # the parent drives the arm
            assert time.monotonic() - begin < 5.0
            stretch(session, 0.3, CHANNEL)
            assert session[CHANNEL].mode() is Mode.TRACK
        finally:
            session.stop()


def in_a_child(work):
    """What a forked child says of `work`."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            answer = str(work())
        except BaseException as error:
            answer = f"{type(error).__name__}: {error}"
        os.write(writing, answer.encode())
        os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with open(reading) as answers:
        return answers.read()


def test_a_forked_child_may_watch_but_not_drive(session):
    track(session, {CHANNEL: AWAY}, 1.5)
    session[CHANNEL].hold()
    port = session[CHANNEL]
    assert in_a_child(lambda: port.published().mode.name) == "HOLD"
    for drive in (lambda: port.write_target(AWAY, 0.5), port.float, port.land, session.rearm, session.land):
        said = in_a_child(drive)
        assert said.startswith(f"LifeCycleError: {CHANNEL}: the arm belongs to process {os.getpid()}")
    session.clock.sleep(0.1)
    assert port.mode() is Mode.HOLD


def test_the_loop_takes_newer_requests_and_targets_only(session):
    """Whoever writes them: a child that was forked before knows older ones."""
    port, block = session[CHANNEL], session[CHANNEL]._commands._block
    port.float()
    older = block.read().copy()
    port.hold()
    track(session, {CHANNEL: AWAY}, 1.5)
    there = port.observe().setpoint_q
    assert older["request"] == Request.FLOAT
    for stamp_s in (-np.inf, session.clock.now()):
        older["target_stamp_s"], older["target_sequence"], older["q"] = stamp_s, 1, 0.0  # as if just given
        block.write(older)
        session.clock.sleep(0.1)
        assert port.mode() in (Mode.HOLD, Mode.TRACK)
        assert port.observe().setpoint_q == pytest.approx(there, abs=1e-6)


COPIES = [copy.copy, copy.deepcopy, pickle.dumps]


@pytest.mark.parametrize("made", COPIES)
def test_an_arm_is_not_copied(rig, made):
    with arm_on(rig, CHANNEL) as arm:
        with pytest.raises(LifeCycleError, match="YamArm stands for arms and can be neither copied nor pickled"):
            made(arm)
        assert arm.observe().mode is Mode.HOLD


@pytest.mark.parametrize("made", COPIES)
def test_a_robot_is_not_copied_and_a_copy_that_is_thrown_away_lands_nothing(rig, made, tmp_path):
    config = sim_config(rig, CHANNEL)
    fields = {name: getattr(config, name) for name in ("channel", "interface", "can_options", "gripper_stops_rad")}
    robot = YamFollower(YamFollowerConfig(**fields, isolation="lockstep", calibration_dir=tmp_path))
    robot.connect()
    try:
        with pytest.raises(LifeCycleError, match="YamFollower stands for arms"):
            made(robot)
        robot.clock.sleep(0.1)
        assert robot.is_connected and enabled(rig)
        robot.get_observation()
    finally:
        robot.discard()
