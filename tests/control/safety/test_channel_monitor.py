"""Silence is a motor's fault only if it was asked."""

from collections import deque

import numpy as np
import pytest

from lerobot_robot_yam.control.safety.channel_monitor import ChannelMonitor
from lerobot_robot_yam.damiao.chain import MotorChain, MotorSpec
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepBus, LockstepRig
from lerobot_robot_yam.state.faults import Trouble
from tests.support.rigged import exchange

HOLD = np.zeros((2, 5))


@pytest.fixture
def chain():
    rig = LockstepRig(arms=["follower_left"])
    with LockstepBus("follower_left", rig=rig.name) as bus:
        specs = [MotorSpec("joint_5", 5, "DM4310"), MotorSpec("joint_6", 6, "DM4310")]
        chain = MotorChain(bus, specs, channel="follower_left")
        chain.special(SpecialCommand.ENABLE)
        yield rig, chain
        chain.special(SpecialCommand.DISABLE)
    rig.close()


def test_a_loop_that_stood_still_does_not_blame_its_motors(chain):
    rig, motors = chain
    watch = ChannelMonitor(motors)
    exchange(motors, HOLD)
    assert watch.check(rig.now()).trouble is None
    rig.sleep(0.25)  # nobody asked
    assert watch.check(rig.now()).trouble is None
    exchange(motors, HOLD)
    assert watch.check(rig.now()).trouble is None


def test_a_motor_that_lets_questions_go_by_is_named(chain):
    rig, motors = chain
    watch = ChannelMonitor(motors)
    exchange(motors, HOLD)
    rig.fault("follower_left", "joint_6", "silent")
    begin = rig.now()
    message = ""
    while not message:
        exchange(motors, HOLD)
        finding = watch.check(rig.now())
        bad, message = finding.bad, finding.message
        assert rig.now() - begin < 2.0
    assert list(bad) == [False, True]
    assert message.startswith("joint_6 (id 6): silent for 0.")
    assert rig.now() - begin > 0.09


def test_a_fault_is_believed_when_it_is_told_twice(chain):
    """One garbled answer may say anything; a motor with a fault says so each time."""
    rig, motors = chain
    watch = ChannelMonitor(motors)
    exchange(motors, HOLD)
    assert watch.check(rig.now()).trouble is None
    rig.fault("follower_left", "joint_6", "nibble", 0xE, sticky=True)
    exchange(motors, HOLD)
    assert watch.check(rig.now()).trouble is None  # the first answer
    assert watch.check(rig.now()).trouble is None  # nothing new was heard
    exchange(motors, HOLD)
    finding = watch.check(rig.now())
    assert finding.trouble is Trouble.OVERLOAD and list(finding.bad) == [False, True]


def test_a_new_loop_believes_at_once_what_it_finds(chain):
    """A stand-by that takes over must not treat limp motors as if they obeyed, not for a tick."""
    rig, motors = chain
    rig.fault("follower_left", "joint_6", "nibble", 0xE, sticky=True)
    exchange(motors, HOLD)
    assert ChannelMonitor(motors).check(rig.now()).trouble is Trouble.OVERLOAD


def test_a_lost_motor_stays_lost_while_the_others_miss_some_questions_too(chain):
    rig, motors = chain
    watch = ChannelMonitor(motors)
    exchange(motors, HOLD)
    rig.fault("follower_left", "joint_6", "silent")
    while not watch.check(rig.now()).bad.any():
        exchange(motors, HOLD)
    rig.fault("follower_left", "joint_5", "drop_next", 8)
    for _ in range(12):
        exchange(motors, HOLD)
        assert watch.check(rig.now()).bad[1]


def test_a_doubled_motor_is_noticed_though_replies_get_lost(chain):
    rig, motors = chain
    watch = ChannelMonitor(motors)
    where = rig.state()["arms"]["follower_left"]["q"][5]  # elsewhere, its readings would be those of a joint that leaps
    rig.fault("follower_left", "joint_6", "duplicate", {"q_rad": where})
    motors.special(SpecialCommand.ENABLE)  # both
    rig.fault("follower_left", "joint_6", "loss_rate", 0.3)
    begin = rig.now()
    finding = watch.check(begin)
    while finding.trouble is None:
        exchange(motors, HOLD)
        finding = watch.check(rig.now())
        assert rig.now() - begin < 3.0
    assert finding.trouble is Trouble.DUPLICATE_ID and "joint_6 (id 6)" in finding.message


@pytest.mark.parametrize("begun_s", [0.385, 0.485, 0.785])
@pytest.mark.parametrize(
    ("motor", "fault", "value"), [("joint_6", "duplicate", True), (None, "foreign", {"id": 6, "rate_hz": 100.0})]
)
def test_strangers_are_told_of_in_time_whenever_they_come(chain, begun_s, motor, fault, value):
    rig, motors = chain
    watch = ChannelMonitor(motors)
    begin = rig.now()
    watch.check(begin)
    while rig.now() < begin + begun_s:
        exchange(motors, HOLD)
        rig.sleep(0.002)
        assert watch.check(rig.now()).trouble is None
    rig.fault("follower_left", motor, fault, value)
    begin = rig.now()
    while watch.check(rig.now()).trouble is None:
        exchange(motors, HOLD)
        rig.sleep(0.002)
        assert rig.now() - begin < 0.5


def test_a_lost_cable_is_named_though_one_motor_fell_silent_first(chain):
    rig, motors = chain
    watch = ChannelMonitor(motors)
    exchange(motors, HOLD)
    assert watch.check(rig.now()).trouble is None
    rig.fault("follower_left", "joint_6", "silent")
    begin = rig.now()
    while rig.now() < begin + 0.06:
        exchange(motors, HOLD)
        assert watch.check(rig.now()).trouble is None
    rig.fault("follower_left", None, "cable_out")
    while (finding := watch.check(rig.now())).trouble is None:
        exchange(motors, HOLD)
        assert rig.now() - begin < 2.0
    assert finding.trouble is Trouble.BUS_SILENT


@pytest.mark.parametrize("begun_s", [0.33, 0.34, 0.35, 0.36])
def test_answers_that_come_late_are_no_second_motors(chain, begun_s):
    """Though those that were given up may have been so in the window before."""
    rig, motors = chain
    watch, queue, room = ChannelMonitor(motors), deque(), 0
    receive = motors._port.recv

    def slow_wire(timeout_s):
        nonlocal room
        while (message := receive(0.0)) is not None:
            queue.append(message)
        if queue and room > 0:
            room -= 1
            return queue.popleft()
        rig.sleep(timeout_s)
        return None

    since_s = rig.now()
    watch.check(since_s)
    motors._port.recv = slow_wire
    while (now := rig.now() - since_s) < 1.2:
        room = 0 if begun_s < now < begun_s + 0.05 else 6  # two answers, and what has gathered in the meantime
        exchange(motors, HOLD)
        assert watch.check(rig.now()).trouble is None
