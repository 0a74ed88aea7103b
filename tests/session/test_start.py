"""The start of two arms: both get torque, or none; whatever comes between."""

import contextlib

import pytest

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.control.process.robot_loop import build
from lerobot_robot_yam.errors import BusError, ChannelInUseError, EmergencyStopError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.records import BlockPair, channel_key
from tests.support.rigged import lockstep_rig, sim_config

CHANNELS = ("follower_left", "follower_right")

rig = lockstep_rig(*CHANNELS)


@contextlib.contextmanager
def loop_on(rig):
    """A loop of both arms: everything is there and as configured; nothing is energised yet."""
    arms = [ResolvedArm(sim_config(rig, channel)) for channel in CHANNELS]
    keys = [channel_key(arm.config.interface, arm.config.channel, rig.name) for arm in arms]
    with contextlib.ExitStack() as rest:
        buses, pairs = [], []
        for arm in arms:
            port = ArmClient(arm)
            rest.callback(port.close)
            pairs.append(BlockPair.of(port.descriptors.copies()))
            rest.callback(pairs[-1].close)
            buses.append(open_bus(arm.config))
            rest.callback(buses[-1].shutdown)
        loop = build(arms, keys, buses, pairs)
        rest.callback(loop.close)
        yield loop


@pytest.fixture
def loop(rig):
    with loop_on(rig) as loop:
        yield loop


def on(rig):
    arms = rig.state()["arms"]
    return {channel for channel in CHANNELS if any(m["enabled"] for m in arms[channel]["motors"].values())}


def test_an_emergency_stop_after_the_inspection_keeps_all_limp(rig, loop):
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        with pytest.raises(EmergencyStopError, match="a test"):
            loop.start()
    finally:
        stop.release()
    assert not on(rig)


@pytest.mark.parametrize("happens", ["emergency stop", "adapter gone"])
def test_what_happens_to_the_first_arm_while_the_second_comes_up_leaves_none_with_torque(rig, loop, happens):
    second, stop = loop._controllers[1], EmergencyStop()
    energise = second.energise

    def energised_until():
        steps = energise()
        while on(rig) != set(CHANNELS):
            yield next(steps)
        if happens == "emergency stop":
            stop.latch("a test")
        else:
            rig.fault(CHANNELS[0], None, "adapter_gone")
        yield from steps

    second.energise = energised_until
    try:
        with pytest.raises((BusError, EmergencyStopError)):
            loop.start()
    finally:
        stop.release()
    assert on(rig) == ({CHANNELS[0]} if happens == "adapter gone" else set())  # nothing reaches the motors there


@pytest.mark.parametrize("foreign", [{"id": 3, "rate_hz": 30.0}, {"id": 0x13, "rate_hz": 30.0, "payload": "zero"}])
def test_who_comes_up_listens_before_it_says_a_word(rig, foreign):
    """Another computer drives the arm, or its motors answer somebody: not one frame of ours goes out."""
    rig.fault(CHANNELS[1], None, "foreign", foreign)
    rig.trace_start(CHANNELS[1])
    with pytest.raises(ChannelInUseError, match=f"{CHANNELS[1]} is already being driven"), loop_on(rig):
        pytest.fail("it has come up")
    assert rig.trace(CHANNELS[1]) == []
    assert not on(rig)
