"""kill -9 of the control process: the stand-by has the arms before their motors' watchdogs act, and lands them."""

import logging
import os
import signal
import time

import numpy as np
import pytest

from lerobot_robot_yam.arm.landing import LANDING_SPEED_RAD_S
from lerobot_robot_yam.arm.lifecycle import Mode
from lerobot_robot_yam.arm.session import ArmSession
from lerobot_robot_yam.errors import MotorError, StaleStateError
from lerobot_robot_yam.rig.control import running_rig, runs

from .rigged import sim_config, track

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


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
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


def test_without_the_stand_by_the_arm_falls(rig):
    """What it is there for, and that the test above can fail."""
    session = start(rig, "follower_left")
    stretch(session, 1.5, "follower_left")
    since = last_event(rig)
    os.kill(stand_by_pid(session), signal.SIGKILL)
    time.sleep(0.1)
    session["follower_left"].observe()  # nothing depends on it
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


def killed_at_a_random_tick(rig, channel, rng, victim):
    """One death; returns drop of the tip in m, seconds until landing began, greatest joint speed, seconds over time."""
    session = start(rig, channel)
    port = session[channel]
    try:
        stretch(session, 0.9 + rng.uniform(0, 0.1), channel)
        since = last_event(rig)
        rig.watch_start(channel)
        travel = np.abs(port.observe().setpoint_q - port.hardware.rest_q)
        os.kill(victim(session), signal.SIGKILL)
        begin = time.monotonic()
        while port.mode() is not Mode.LAND:
            assert time.monotonic() < begin + 1.0
        began_s = time.monotonic() - begin
        tip_drop = rig.watch(channel)["max_tcp_drop_m"]  # until the landing began
        while port.mode() is not Mode.OFF:
            time.sleep(0.005)
        took_s = time.monotonic() - begin
        seen = rig.watch(channel)
    finally:
        session.stop()
    assert not faults(rig, since)
    lowering = 0.35  # the wrist is raised while folding and lowered afterwards
    over_s = took_s - (travel[1:].max() + lowering) / LANDING_SPEED_RAD_S
    return tip_drop, began_s, max(seen["max_speed_rad_s"]), over_s


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_control_process_killed_at_100_random_ticks():
    rng, rows = np.random.default_rng(5), []
    with running_rig(arms=["follower_left"]) as rig:
        for _ in range(100):
            rows.append(killed_at_a_random_tick(rig, "follower_left", rng, control_pid))
    drop, began, speed, over = np.max(rows, axis=0)
    logger.info(
        f"drop {drop * 1e3:.2f} mm, landing begins after {began * 1e3:.0f} ms, {speed:.2f} rad/s, {over:+.2f} s"
    )
    assert drop <= 0.005 and began <= 0.1 and speed <= LANDING_SPEED_RAD_S * 1.1 and over <= 1.0
