"""Wrists that are moved by hand, on the rig: one, several, and arms that cannot be asked."""

import time

import can
import pytest

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.setup.adapter_watch import WristWatch
from tests.support.doctor_desk import ARM

CHANNELS = ("leader_left", "leader_right")


@pytest.fixture(scope="module")
def arms():
    """A rig with two leaders, and their buses by channel."""
    with running_rig(arms=CHANNELS) as rig:
        buses = {name: can.Bus(interface="yam_sim", channel=name, rig=rig.name) for name in CHANNELS}
        yield rig, buses
        for bus in buses.values():
            bus.shutdown()


def turned(rig, channel, by_rad):
    """Begin to turn a wrist by hand."""
    q = rig.state()["arms"][channel]["q"]
    rig.lift(channel, [*q[:-1], q[-1] + by_rad], seconds=0.5, then_release=True)


def test_several_wrists_are_told_and_then_the_one_that_moves_alone_is_found(arms):
    rig, buses = arms
    watch, said = WristWatch(buses), []
    for channel in CHANNELS:
        turned(rig, channel, 0.8)

    def answer(seconds):
        if said and not any(event["kind"] == "turned" for event in rig.events()):
            time.sleep(1.0)  # until both have come to rest
            rig.log("turned")
            turned(rig, "leader_right", -0.8)
        time.sleep(seconds)

    assert watch.wait(answer, said.append) == ("leader_right", "")
    assert said and said[0].startswith("several arms move")
    assert WristWatch(buses).wait(lambda _: "typed", said.append) == ("", "typed")


def test_the_hand_that_still_moves_the_arm_before_is_no_answer(arms):
    rig, buses = arms
    turned(rig, "leader_left", -0.8)
    watch, typed = WristWatch(buses), iter([None] * 20)

    def answer(seconds):
        time.sleep(seconds)
        return next(typed, "typed")

    assert watch.wait(answer, lambda text: None) == ("", "typed")


def test_an_energised_arm_is_refused(arms):
    _, buses = arms
    chain = MotorChain(buses["leader_left"], ARM, channel="leader_left")
    chain.special(SpecialCommand.ENABLE)
    try:
        with pytest.raises(MotorError, match="leader_left: motor 4 is energised"):
            WristWatch(buses)
    finally:
        chain.special(SpecialCommand.DISABLE)


def test_arms_without_power_are_told(arms):
    rig, buses = arms
    for channel in CHANNELS:
        rig.fault(channel, None, "silent")
    with pytest.raises(MotorError, match="no arm answers on leader_left, leader_right"):
        WristWatch(buses)
