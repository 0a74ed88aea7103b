"""Wrists that are moved by hand, on the rig: one, several, and arms that cannot be asked."""

import contextlib
from functools import partial

import can
import pytest

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.setup.adapter_watch import WristWatch
from tests.support.doctor_desk import ARM
from tests.support.rigged import lockstep_rig

CHANNELS = ("leader_left", "leader_right")


rig = lockstep_rig(*CHANNELS)


@pytest.fixture
def buses(rig):
    """Open buses by channel."""
    with contextlib.ExitStack() as opened:
        bus = partial(can.Bus, interface="yam_lockstep", rig=rig.name)
        yield {name: opened.enter_context(bus(channel=name)) for name in CHANNELS}


def turned(rig, channel, by_rad):
    """Begin to turn a wrist by hand."""
    q = rig.state()["arms"][channel]["q"]
    rig.lift(channel, [*q[:-1], q[-1] + by_rad], seconds=0.5, then_release=True)


def test_several_wrists_are_told_and_then_the_one_that_moves_alone_is_found(rig, buses):
    watch, said = WristWatch(buses), []
    for channel in CHANNELS:
        turned(rig, channel, 0.8)

    def answer(seconds):
        if said and not any(event["kind"] == "turned" for event in rig.events()):
            rig.sleep(1.0)  # until both have come to rest
            rig.log("turned")
            turned(rig, "leader_right", -0.8)
        rig.sleep(seconds)

    assert watch.wait(answer, said.append) == ("leader_right", "")
    assert said and said[0].startswith("several arms move")
    assert WristWatch(buses).wait(lambda _: "typed", said.append) == ("", "typed")


def test_the_hand_that_still_moves_the_arm_before_is_no_answer(rig, buses):
    turned(rig, "leader_left", -0.8)
    watch, typed = WristWatch(buses), iter([None] * 20)

    def answer(seconds):
        rig.sleep(seconds)
        return next(typed, "typed")

    assert watch.wait(answer, lambda text: None) == ("", "typed")


def test_an_energised_arm_is_refused(buses):
    chain = MotorChain(buses["leader_left"], ARM, channel="leader_left")
    chain.special(SpecialCommand.ENABLE)
    try:
        with pytest.raises(MotorError, match="leader_left: motor 4 is energised"):
            WristWatch(buses)
    finally:
        chain.special(SpecialCommand.DISABLE)


def test_arms_without_power_are_told(rig, buses):
    for channel in CHANNELS:
        rig.fault(channel, None, "silent")
    with pytest.raises(MotorError, match="no arm answers on leader_left, leader_right"):
        WristWatch(buses)
