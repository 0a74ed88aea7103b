"""Silence is a motor's fault only if it was asked."""

import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.arm.watch import MotorWatch
from lerobot_robot_yam.damiao.chain import MotorChain, MotorSpec
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.rig.control import running_rig

HOLD = np.zeros((2, 5))


@pytest.fixture
def chain():
    with running_rig(arms=["follower_left"]) as rig:
        bus = can.Bus(interface="yam_sim", channel="follower_left", rig=rig.name)
        specs = [MotorSpec("joint_5", 5, "DM4310"), MotorSpec("joint_6", 6, "DM4310")]
        chain = MotorChain(bus, specs, channel="follower_left")
        chain.special(SpecialCommand.ENABLE)
        yield rig, chain
        chain.special(SpecialCommand.DISABLE)
        bus.shutdown()


def test_a_loop_that_stood_still_does_not_blame_its_motors(chain):
    _, motors = chain
    watch = MotorWatch(motors)
    motors.exchange(HOLD)
    assert watch.check(time.monotonic()).trouble is None
    time.sleep(0.25)  # nobody asked
    assert watch.check(time.monotonic()).trouble is None
    motors.exchange(HOLD)
    assert watch.check(time.monotonic()).trouble is None


def test_a_motor_that_lets_questions_go_by_is_named(chain):
    rig, motors = chain
    watch = MotorWatch(motors)
    motors.exchange(HOLD)
    rig.fault("follower_left", "joint_6", "silent")
    begin = time.monotonic()
    message = ""
    while not message:
        motors.exchange(HOLD)
        finding = watch.check(time.monotonic())
        bad, message = finding.bad, finding.message
        assert time.monotonic() - begin < 2.0
    assert list(bad) == [False, True]
    assert message.startswith("joint_6 (id 6): silent for 0.")
    assert time.monotonic() - begin > 0.09
