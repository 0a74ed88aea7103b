"""Who takes an arm over from a loop that has died knows what that knew, and moves nothing by it."""

import contextlib
import os

import numpy as np
import pytest

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.control.state_publisher import ControllerBlocks
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.rigged import lockstep_rig, running_arm, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
HEAVY = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # a wrist joint is braked between two samples, and reads as still
POSE = np.array([0.2, 1.0, 1.1, -0.3, 0.1, 0.1])


rig = lockstep_rig(CHANNEL)
session = running_arm(CHANNEL)


@pytest.fixture
def heir_of(rig):
    """Makes a controller that takes over from a record."""
    with contextlib.ExitStack() as opened:

        def heir_of(record):
            config = sim_config(rig, CHANNEL)
            bus = open_bus(config)
            opened.callback(bus.shutdown)
            heir = ArmController(ResolvedArm(config), bus)
            heir.adopt(record, rig.now())
            return heir

        yield heir_of


def record_of(rig):
    """What the loop has published last."""
    block = SharedBlock(state_path(channel_key("yam_lockstep", CHANNEL, rig.name)), STATE_DTYPE, create=False)
    try:
        return block.read().copy()
    finally:
        block.close()


def newest_of(session):
    """The same, where the link to the block has ended with who has published it last."""
    return session[CHANNEL]._states.block.read()


@pytest.mark.parametrize("silent", [False, True])
def test_who_takes_over_has_its_commands_ready_and_does_not_give_up_on_silence(rig, heir_of, session, silent):
    track(session, {CHANNEL: POSE}, 1.2)
    record = record_of(rig)
    if silent:  # for a moment, as on a machine that stands still
        rig.fault(CHANNEL, None, "silent")
    heir = heir_of(record)
    assert heir.mode is Mode.LAND
    assert (heir.actuation.commands[:6, 2] > 1.0).all()  # kp, Nm/rad
    assert np.abs(heir.actuation.setpoint.q[:6] - POSE).max() < 0.05
    assert np.abs(heir.actuation.commands[:6, 0] - POSE).max() < 0.05  # what it sends, after the torque clip
    assert np.abs(heir.actuation.commands[:6, 4]).max() < 10.0  # Nm


def test_who_takes_over_leaves_a_joint_that_is_not_heard_where_it_was_sent(rig, heir_of, session):
    track(session, {CHANNEL: POSE}, 1.2)
    rig.fault(CHANNEL, "joint_2", "loss_rate", 1.0)
    session.clock.sleep(0.6)
    session[CHANNEL].land()
    session.clock.sleep(1.0)
    record = record_of(rig)
    heir = heir_of(record)
    there = rig.state()["arms"][CHANNEL]["q"][1]
    assert POSE[1] - there > 0.3
    assert heir.actuation.setpoint.q[1] == pytest.approx(there, abs=0.05)
    assert heir.actuation.commands[1, 0] == pytest.approx(there, abs=0.1)
    slot = 1
    record["fault"][slot] = Fault.OVER_CURRENT  # it had let go before it fell silent
    assert heir_of(record).actuation.setpoint.q[1] == pytest.approx(record["q"][slot])


@pytest.mark.parametrize("lie_rad", spread([0.3, 0.45, -0.3], 1))
def test_who_takes_over_does_not_believe_a_motor_that_was_not_believed(rig, heir_of, session, lie_rad):
    """As old as its last good reading is by then, the joint could have got where it says."""
    track(session, {CHANNEL: POSE}, 1.2)
    rig.fault(CHANNEL, "joint_2", "reading", {"position_rad": lie_rad})
    session.clock.sleep(1.0)
    assert session[CHANNEL].mode() is Mode.FAULT
    heir = heir_of(record_of(rig))
    arm = heir.actuation
    for _ in range(5):
        arm.send()
        heir.interface.receive(heir.clock.now() + 0.004)
    assert arm.chain.distrusted.tolist() == [False, True, *[False] * 5]
    assert abs(arm.q[1] - POSE[1]) < 0.05
    assert np.abs(arm.setpoint.q[:6] - POSE).max() < 0.05


def test_who_takes_over_from_soft_gains_holds_the_arm_where_a_hand_keeps_it(rig, heir_of, session):
    """Its own gains would throw it at a set-point that it never was to hold."""
    soft = {"kp": np.full(6, 1.0), "kd": np.ones(6)}
    track(session, {CHANNEL: POSE}, 1.2)
    track(session, {CHANNEL: POSE}, 0.2, **soft)
    for way in np.linspace(0.0, 0.2, 40):
        rig.set_pose(CHANNEL, POSE + way * HEAVY, dq=0.25 * HEAVY)
        track(session, {CHANNEL: POSE}, 0.02, **soft)
    heir = heir_of(record_of(rig))
    assert np.abs(heir.actuation.setpoint.q[:6] - rig.state()["arms"][CHANNEL]["q"][:6]).max() < 0.05


def test_who_takes_over_keeps_the_grip_on_a_thick_object(rig, heir_of, session):
    track(session, {CHANNEL: POSE}, 1.2)
    record = record_of(rig)
    gripper = session[CHANNEL].hardware.joints
    record["setpoint"][gripper] = 0.0  # closed on something that keeps the fingers half open
    heir = heir_of(record)
    assert heir.actuation.q[-1] > 0.4 and heir.actuation.setpoint.q[-1] == 0.0


def test_nobody_takes_over_an_arm_that_is_limp(rig, heir_of, session):
    record = record_of(rig)
    rig.cut_torque(CHANNEL)
    heir = heir_of(record)
    assert heir.mode is Mode.OFF


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # the child only writes, and ends
def test_a_loop_whose_arm_another_process_has_taken_over_sends_it_nothing_more(rig, heir_of, session):
    """It was taken for dead, and wakes up: two would pull the arm to and fro."""
    track(session, {CHANNEL: POSE}, 1.2)
    record = record_of(rig)
    heir = heir_of(record)
    pid = os.fork()
    if not pid:  # the stand-by, as far as the blocks go
        try:
            key = channel_key("yam_lockstep", CHANNEL, rig.name)
            pair = session._runner._pairs[0]  # which the stand-by has inherited
            ControllerBlocks(heir, key, pair, adopt=record).publish(rig.now(), 1)
        finally:
            os._exit(0)
    os.waitpid(pid, 0)
    assert newest_of(session)["owner_pid"] == pid
    rig.trace_start(CHANNEL)
    with pytest.raises(LifeCycleError, match="another process has taken the arms over"):
        session.clock.sleep(0.05)
    assert rig.trace(CHANNEL) == []
    assert newest_of(session)["owner_pid"] == pid  # nor does it publish anything
    state_path(channel_key("yam_lockstep", CHANNEL, rig.name)).unlink()  # it has ended without removing its link
