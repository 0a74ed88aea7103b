"""Killed with -9, again and again: what an arm does until somebody has it, how it lands, and how long that takes."""

import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.landing.landing_move import LANDING_SPEED_RAD_S
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.faults import stale_overshoot_rad_s
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from scripts import recorders
from tests.control.process.test_stand_by import control_pid, faults, last_event, start, stretch, wait_mode
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.rigged import sim_config, track
from tests.support.stillness import Stillness

pytestmark = pytest.mark.alone

logger = logging.getLogger(__name__)

WATCHDOG_MOST_S = 0.25  # what the machine has to lose before a motor's 0.4 s can be no fault of ours
MOST_LOST_S = 0.1  # of the second that a landing may take beyond its way


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
        recorders.watch_start(rig, channel)
        hardware = ResolvedArm(sim_config(rig, channel))
        travel = np.abs(block.read()["setpoint"][: hardware.joints] - hardware.rest_q)
        os.kill(pid, signal.SIGKILL)
        begin = time.monotonic()
        while block.read()["mode"] != Mode.LAND:
            assert time.monotonic() < begin + 1.0
        began_s = time.monotonic() - begin
        tip_drop = recorders.watch(rig, channel)["max_tcp_drop_m"]  # until the landing began
        while block.read()["mode"] != Mode.OFF:
            assert time.monotonic() < begin + 20.0
            time.sleep(0.005)
        took_s = time.monotonic() - begin
    finally:
        block.close()
    seen = recorders.watch(rig, channel)
    assert not faults(rig, since) or machine.lost_s() - lost_s > WATCHDOG_MOST_S
    if rig.stats()["slips"] > slips or machine.lost_s() - lost_s > MOST_LOST_S:
        return None
    time.sleep(0.5)  # who is let go of in the air has moved far by then
    assert moved_after_cut_m(rig, channel) < MOST_M
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
from tests.control.process import test_stand_by as t
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
    limits = ResolvedArm(sim_config(rig, channel)).speed_limit[:6]
    for _ in range(tries):
        session = ArmSession([sim_config(rig, channel)])
        session.start()
        try:
            stretch(session, 1.5, channel)
            track(session, {channel: [-0.8, 0.9, 1.6, 0.3, 0.4, -0.5]}, rng.uniform(0.05, 0.6))
            since, killed = last_event(rig), time.monotonic()
            recorders.watch_start(rig, channel)
            os.kill(control_pid(session), signal.SIGKILL)
            wait_mode(session[channel], Mode.LAND)
            began_s = time.monotonic() - killed
            wait_mode(session[channel], Mode.OFF, 15.0)
        finally:
            session.stop()
        seen = recorders.watch(rig, channel)
        assert not faults(rig, since) and began_s <= 0.1
        late_s = np.maximum(np.array(seen["max_command_age_s"][:6]) - 0.008, 0.0)
        allowed = 1.3 * limits + [stale_overshoot_rad_s(float(age_s)) for age_s in late_s]
        assert np.all(seen["max_speed_rad_s"][:6] < allowed), seen
        time.sleep(0.5)
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
    assert np.min(rows, axis=0)[3] >= 0.0, "down before it can have come down at that speed"
    for row in sorted(rows, key=lambda row: row[2])[-3:]:
        logger.info("among the fastest: drop %.4f m, began after %.3f s, %.3f rad/s, %+.3f s", *row)
    logger.info(
        f"{killed.__name__} x {len(rows)}: drop {drop * 1e3:.2f} mm, landing begins after {began * 1e3:.0f} ms, "
        f"{speed:.2f} rad/s, {over:+.2f} s"
    )
    assert drop <= 0.005 and began <= 0.1 and speed <= LANDING_SPEED_RAD_S and over <= 1.0
