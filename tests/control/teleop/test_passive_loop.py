"""The loop of leaders without motors on simulated encoders, in lock-step: emergency stop, and contacts that bounce."""

import contextlib

import can
import pytest

from lerobot_robot_yam.arm.config import LeadArmConfig
from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS, PassiveConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.teleop import passive_loop
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import BlockPair, channel_key

LEADER = "leader_left"
NAN = float("nan")


class Running:
    """A loop of one leader, and a script that goes on while it ticks: it yields seconds to wait, or a condition."""

    def __init__(self, rig, lead=None):
        self.rig, self.ticks = rig, []
        config = LeadArmConfig(
            name=LEADER,
            channel=LEADER,
            interface="yam_lockstep",
            can_options={"rig": rig.name},
            gripper="yam_teaching_handle",
            start="float",
            passive=PassiveConfig(joint_sign=JOINT_SIGNS["desk"]),
            lead=lead,
        )
        self._arm = ResolvedArm(config)

    def run(self, script):
        """Run it until the script ends."""
        steps, until_s = script(self), 0.0
        key = channel_key("yam_lockstep", LEADER, self.rig.name)
        with can.Bus(interface="yam_lockstep", channel=LEADER, rig=self.rig.name) as bus:
            self.client = ArmClient(self._arm, self.rig)

            def must_end():
                nonlocal until_s
                self.ticks.append(self.client.published())
                if self.rig.now() >= until_s:
                    seconds = next(steps, None)
                    if seconds is None:
                        return True
                    until_s = self.rig.now() + seconds
                return False

            pair = BlockPair.of(self.client.descriptors.copies())
            try:
                passive_loop.run([self._arm], [bus], [key], [pair], lambda _: None, must_end)
            finally:
                pair.close()
                self.client.close()

    @property
    def mode(self):
        return self.ticks[-1].mode


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig("passive_leaders", arms=[LEADER])) as rig:
        yield rig


@pytest.fixture
def stop():
    stop = EmergencyStop()
    yield stop
    stop.release()


def test_it_stops_with_the_others_and_goes_on_once_its_trigger_is_squeezed(rig, stop):
    rig.hand(LEADER, [0.2], [[0.0] * 6], trigger=0.9)

    def script(loop):
        yield 0.3
        assert loop.mode is Mode.FLOAT
        stop.latch("test")
        yield 0.05
        assert loop.mode is Mode.STOPPED
        stop.release()
        yield 0.2
        assert loop.mode is Mode.STOPPED  # squeezed all the time: perhaps it lies on its trigger
        rig.hand(LEADER, [0.1], [[0.0] * 6], trigger=0.0)
        yield 0.3
        assert loop.mode is Mode.STOPPED
        rig.hand(LEADER, [0.1], [[0.0] * 6], trigger=1.0)
        yield 0.3
        assert loop.mode is Mode.FLOAT

    Running(rig).run(script)


def test_a_gate_that_waits_for_a_person_needs_no_squeeze(rig, stop):
    def script(loop):
        yield 0.2
        stop.latch("test")
        yield 0.05
        assert loop.mode is Mode.STOPPED
        stop.release()
        yield 0.05
        assert loop.mode is Mode.FLOAT

    Running(rig, LeadConfig(follower="follower_left", gate="auto")).run(script)


def test_a_contact_that_bounces_is_one_press(rig):
    def script(loop):
        yield 0.2
        for _ in range(4):
            rig.press(LEADER, "sync", 0.006)
            yield 0.01
        rig.press(LEADER, "sync", 0.2)
        yield 0.4

    loop = Running(rig)
    loop.run(script)
    top = [state.buttons[0] for state in loop.ticks]
    edges = [after for before, after in zip(top[:-1], top[1:], strict=True) if after is not before]
    assert edges == [True, False]


def test_a_channel_that_is_gone_is_told_of_once_and_so_is_its_return(rig, caplog):
    caplog.set_level("INFO", passive_loop.__name__)

    def script(loop):
        yield 0.2
        rig.fault(LEADER, None, "link_down", True)
        yield 1.0
        before = loop.ticks[-1]
        yield 0.2
        assert loop.ticks[-1].stamp_s == before.stamp_s  # old readings stay old
        rig.fault(LEADER, None, "link_down", False)
        yield 0.5

    Running(rig).run(script)
    told = [record.getMessage() for record in caplog.records if record.name == passive_loop.__name__]
    assert len(told) == 2
    assert told[0].startswith(f"{LEADER}: nothing is heard of its channel") and "heard again" in told[1]


@pytest.mark.parametrize(
    ("triggers", "stopped"),
    [
        ([(0.0, 0.0), (1.0, 0.0)], True),
        ([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], True),
        ([(0.0, 0.0), (1.0, 1.0)], False),
        ([(0.0, NAN), (1.0, 1.0)], True),
        ([(0.0, 0.0), (1.0, NAN)], True),
        ([(1.0, 1.0)], True),
    ],
)
def test_two_leaders_go_on_when_both_are_in_a_hand(stop, triggers, stopped):
    both = passive_loop.PassiveStop(stop, {0: "left", 1: "right"})
    assert not both.check((0.0, 0.0))
    stop.latch("test")
    assert both.check((0.0, 0.0))
    stop.release()
    assert [both.check(pair) for pair in triggers][-1] is stopped
