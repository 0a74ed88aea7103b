"""A leader arm on the virtual rig: its handle, and the hand that moves it."""

import numpy as np
import pytest

from lerobot_robot_yam.state.modes import Mode
from tests.support.rigged import arm_on, either_rig

rig = either_rig("leader_left")


def test_a_leader_floats_and_reports_its_handle(rig):
    with arm_on(rig, "leader_left") as arm:
        assert arm.observe().mode is Mode.FLOAT
        rig.trigger("leader_left", 0.5)
        rig.buttons("leader_left", sync=True)
        arm.clock.sleep(0.3)
        state = arm.observe()
        assert state.trigger == pytest.approx(0.5, abs=0.02)
        assert state.buttons == (True, False)
        rig.fault("leader_left", None, "handle_silent")
        arm.clock.sleep(0.6)
        assert arm.observe().trigger is None  # never a zero


def test_the_operators_hand_lets_a_leader_go_that_works_against_it(rig):
    """As when it lands: otherwise hand and landing would fight for ever."""
    with arm_on(rig, "leader_left") as arm:
        pose = [0.2, 1.0, 0.9, -0.3, 0.0, 0.0]
        rig.hand("leader_left", [2.0], [pose])
        arm.clock.sleep(2.5)
        leader = rig.state()["arms"]["leader_left"]
        assert leader["held"] and not leader["resists"]
        assert np.abs(np.array(leader["q"]) - pose).max() < 0.05
    leader = rig.state()["arms"]["leader_left"]
    assert not leader["held"]
    assert not any(m["enabled"] for m in leader["motors"].values())
