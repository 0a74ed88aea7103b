"""A rig in lock-step: its own time, the same motors, the same bits every time."""

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S
from lerobot_robot_yam.errors import BusError, ConfigError
from lerobot_robot_yam.rig.lockstep.lockstep_cameras import LockstepCamera
from lerobot_robot_yam.rig.lockstep.lockstep_rig import BEGIN_S, find_lockstep
from tests.support.rigged import exchange, lockstep_rig

JOINTS = [MotorSpec(f"joint_{i + 1}", i + 1, "DM4340" if i < 3 else "DM4310") for i in range(6)]


rig = lockstep_rig("follower_left")


def open_bus(rig, **options):
    return can.Bus(interface="yam_lockstep", channel="follower_left", rig=rig.name, **options)


def test_time_passes_only_on_its_clock(rig):
    assert rig.now() == BEGIN_S
    rig.sleep(0.1)
    assert rig.now() == pytest.approx(BEGIN_S + 0.1)
    assert rig.state()["sim_s"] == pytest.approx(0.1, abs=0.0011)
    with pytest.raises(ValueError):
        rig.sleep(-1.0)


def test_a_brief_state_agrees_with_the_whole_one(rig):
    whole, brief = rig.state(), rig.state(brief=True)
    arm, short = whole["arms"]["follower_left"], brief["arms"]["follower_left"]
    assert short["motors"] == {name: {"enabled": motor["enabled"]} for name, motor in arm["motors"].items()}
    assert "tcp_site" in arm and "tcp_site" not in short
    assert all(short[key] == arm[key] for key in short if key != "motors")
    assert {**brief, "arms": None} == {**whole, "arms": None}


def test_frames_take_their_time_on_the_wire(rig):
    with open_bus(rig) as bus:
        chain = MotorChain(bus, JOINTS, channel="follower_left")
        assert chain.clock is rig
        assert all(chain.special(SpecialCommand.ENABLE))
        before = rig.now()
        exchange(chain, np.zeros((6, 5)))
        assert rig.now() - before > 11.9 * FRAME_TIME_S
        assert (rig.now() - chain.asked_s < 0.002).all()


def test_a_receiver_waits_in_the_rigs_time(rig):
    with open_bus(rig) as bus:
        assert bus.recv(0.5) is None
        assert rig.now() == pytest.approx(BEGIN_S + 0.5)


def test_filters_are_heeded(rig):
    only = [{"can_id": 0x7, "can_mask": 0x7FF, "extended": False}]
    with open_bus(rig, can_filters=only) as filtered, open_bus(rig) as other:
        MotorChain(other, JOINTS, channel="follower_left").refresh()
        assert filtered.recv(0.01) is None


def test_a_restart_ends_open_buses(rig):
    with open_bus(rig) as bus:
        rig.sleep(1.0)
        rig.restart()
        assert rig.now() == BEGIN_S and rig.state()["sim_s"] == 0.0
        with pytest.raises(BusError, match="restarted"):
            bus.send(can.Message(arbitration_id=1, data=bytes(8), is_extended_id=False))


def test_wrong_names_are_refused(rig):
    with pytest.raises(ConfigError, match="no rig in lock-step 'nowhere'"):
        can.Bus(interface="yam_lockstep", channel="follower_left", rig="nowhere")
    with pytest.raises(BusError, match="no channel 'follower_up'"):
        can.Bus(interface="yam_lockstep", channel="follower_up", rig=rig.name)
    rig.close()
    assert find_lockstep(rig.name) is None


def test_pictures_show_the_instant_and_are_the_same_again(rig):
    camera = LockstepCamera(rig, "top", 64, 48, 30)
    with pytest.raises(Exception, match="not connected"):
        camera.latest()
    camera.connect()
    first, stamp_s = camera.latest()
    first = first.copy()
    assert stamp_s == pytest.approx(rig.device.world.stamp_s)
    rig.sleep(0.1)
    second, later_s = camera.latest()
    assert later_s == pytest.approx(stamp_s + 0.1, abs=0.0011)
    assert (second != first).any()  # the sensor's noise
    rig.restart()
    assert np.array_equal(camera.latest()[0], first)
    camera.close()
