"""A planned line, driven by the shipped control loop over CAN frames of the virtual rig: within 2 mm of straight."""

import numpy as np
import pytest

from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.waldo.kinematics.frames import commanded
from lerobot_robot_yam.waldo.kinematics.serial_chain import tool_centre
from lerobot_robot_yam.waldo.planning.planner import Planner
from tests.support.rigged import rig_of, sim_config

CHANNEL = "follower_left"
TICK_S = 0.01  # of whoever sends the targets


@pytest.fixture
def arm():
    """With `track_integral`, as Commander's arms have it: without, friction leaves up to 2.7 mm."""
    with rig_of("lockstep", arms=(CHANNEL,)) as rig:
        session = ArmSession([sim_config(rig, CHANNEL, track_integral=True)], isolation="lockstep")
        session.start()
        yield session
        session.discard()


def play(session, plan):
    """Carries out a plan; returns what was measured at each tick, (k, n) rad."""
    measured = []
    for t in np.arange(0.0, plan.duration_s + 0.5, TICK_S):
        q, dq = plan.at(t)
        session[CHANNEL].write_target(q, None, dq if t < plan.duration_s else np.zeros(len(q)))
        session.clock.sleep(TICK_S)
        measured.append(session[CHANNEL].observe().q)
    return np.array(measured)


def test_the_arm_keeps_to_the_line(arm):
    planner = Planner(arm.hardware(CHANNEL))
    planner.tool = tool_centre(planner.hardware.gripper)
    play(arm, planner.joints(arm[CHANNEL].observe().setpoint_q, planner.home_q, speed=1.0))
    q = planner.home_q
    for way in ([0, 0, 80, 0, 0, 0], [0, -120, 0, 0, 0, 0], [60, 60, -60, 0, 0, 0], [-60, 60, -20, 0, 0, 0]):
        line = planner.line(q, commanded(planner.pose(q), way, rel=True), speed=1.0)
        tool = planner.pose(play(arm, line))[:, :3, 3]
        start, end = planner.pose(line.q[[0, -1]])[:, :3, 3]
        along = (end - start) / np.linalg.norm(end - start)
        off = tool - start
        off -= np.outer(off @ along, along)
        assert np.linalg.norm(off, axis=1).max() < 2e-3
        q = line.q[-1]
