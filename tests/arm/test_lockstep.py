"""The shipped control loop in lock-step: the caller's sleep is what lets it tick."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.body import ArmBody
from lerobot_robot_yam.arm.hardware import Hardware
from lerobot_robot_yam.arm.lifecycle import Mode
from lerobot_robot_yam.arm.policy import HUNG_S, STALE_OVERSHOOT_RAD_S
from lerobot_robot_yam.arm.session import ArmSession
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, StaleStateError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.lockstep import LockstepBus, LockstepRig

from .rigged import sim_config, track

CHANNELS = ("follower_left", "follower_right")
GOAL = np.array([0.3, 0.8, 0.9, -0.2, 0.0, 0.1])


@pytest.fixture
def rig():
    rig = LockstepRig(arms=CHANNELS)
    yield rig
    rig.close()


def config(rig, channel):
    return sim_config(rig, channel, interface="yam_lockstep")


def moved(rig):
    """Both arms to a goal; returns what was measured on the way, (k, 2, 7)."""
    session = ArmSession([config(rig, channel) for channel in CHANNELS], isolation="lockstep")
    session.start()
    seen = []
    for _ in range(60):
        for channel in CHANNELS:
            session[channel].track(GOAL, 0.3)
        session.clock.sleep(1 / 30)
        states = [session[channel].observe() for channel in CHANNELS]
        seen.append([[*state.q, state.gripper] for state in states])
    return session, np.array(seen)


def test_the_same_bits_every_time(rig):
    session, first = moved(rig)
    session.discard()
    rig.restart()
    again, second = moved(rig)
    again.discard()
    assert np.array_equal(first, second)
    assert np.abs(first[-1, :, :6] - GOAL).max() < 0.02


def test_it_lands_in_simulated_time(rig):
    session, _ = moved(rig)
    before = rig.now()
    session.stop()
    assert 1.0 < rig.now() - before < 10.0
    arms = rig.state()["arms"]
    assert not any(motor["enabled"] for channel in CHANNELS for motor in arms[channel]["motors"].values())


def test_a_state_is_fresh_while_nobody_sleeps_and_motors_let_go_when_the_loop_does(rig):
    session, _ = moved(rig)
    session["follower_left"].observe()
    rig.sleep(1.0)  # time that the loop does not get: to it the world has leapt
    with pytest.raises(StaleStateError):
        session["follower_left"].observe()
    session.discard()


def test_motors_have_a_few_ticks_to_say_that_they_are_enabled(rig):
    with LockstepBus(CHANNELS[0], rig=rig.name) as bus:
        body = ArmBody(config(rig, CHANNELS[0]), bus, None, None)
        body.inspect()
        rig.fault(CHANNELS[0], "joint_5", "drop_next", 4)
        body.energise()
        assert all(motor["enabled"] for motor in rig.state()["arms"][CHANNELS[0]]["motors"].values())
        body.abandon()


def test_a_loop_that_hangs_while_its_arm_sets_out_leaves_it_a_bounded_speed(rig):
    """Motors go on with what they were told last, the feed-forward of an acceleration among it."""
    session = ArmSession([config(rig, CHANNELS[0])], isolation="lockstep")
    session.start()
    track(session, {CHANNELS[0]: [0.0, 1.0, 2.2, 0.0, 0.0, 0.0]}, 2.2)
    track(session, {CHANNELS[0]: [0.0, 2.2, 0.8, 0.8, 0.0, 0.0]}, 0.04)
    rig.watch_start(CHANNELS[0])
    rig.sleep(HUNG_S + 0.03)  # until the stand-by commands
    speed = np.array(rig.watch(CHANNELS[0])["max_speed_rad_s"][:6])
    assert speed.max() > 2.0  # it does set out, and the worst of it is seen
    assert np.all(speed < Hardware(config(rig, CHANNELS[0])).speed_limit[:6] + STALE_OVERSHOOT_RAD_S), speed
    session.discard()


def test_requests_are_answered(rig):
    session, _ = moved(rig)
    port = session["follower_right"]
    port.float()
    assert port.mode() is Mode.FLOAT
    port.hold()
    session.clock.sleep(0.1)
    assert port.mode() is Mode.HOLD
    session.discard()


@pytest.mark.alone
def test_only_a_world_of_ones_own_can_be_discarded(rig):
    session, _ = moved(rig)
    session.discard()
    session.discard()
    with pytest.raises(ConfigError, match="isolation"):
        ArmSession([config(rig, CHANNELS[0])], isolation="somewhere")
    with running_rig(arms=["follower_left"]) as live:
        alive = ArmSession([sim_config(live, "follower_left")])
        alive.start()
        try:
            with pytest.raises(LifeCycleError, match="so that the arms land"):
                alive.discard()
        finally:
            alive.stop()
