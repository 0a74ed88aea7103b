"""The chain against the virtual rig: the same code path as on hardware."""

import threading
import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao import motor_inspection
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.handle_check import prepare_handle
from lerobot_robot_yam.damiao.handle_encoder import HandleEncoder
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ChannelInUseError, MotorError
from tests.support.rigged import exchange

ARM = [MotorSpec(f"joint{i + 1}", i + 1, kind) for i, kind in enumerate(["DM4340"] * 3 + ["DM4310"] * 3)]
GRIPPER = MotorSpec("gripper", 7, "DM4310")


def test_bring_up_and_exchange_with_a_follower():
    with can.Bus(interface="yam_sim", channel="follower_left") as bus:
        chain = MotorChain(bus, [*ARM, GRIPPER], channel="follower_left")
        motor_inspection.listen(bus, motor_inspection.LISTEN_S, range(1, 8), chain.channel)
        motor_inspection.verify(chain)
        assert chain.fault.tolist() == [Fault.DISABLED] * 7
        assert all(chain.special(SpecialCommand.ENABLE))
        commands = np.zeros((7, 5))
        commands[:, 0] = chain.position_rad
        commands[:, 2:4] = 10.0, 1.0
        answered = sum(exchange(chain, commands, timeout_s=0.5) for _ in range(50))
        assert answered == 50
        assert chain.fault.tolist() == [Fault.NORMAL] * 7
        assert not chain.duplicates.any()
        assert chain.foreign == {}
        assert np.all(chain.stamp_s <= time.monotonic())
        assert all(chain.special(SpecialCommand.DISABLE))
        assert chain.fault.tolist() == [Fault.DISABLED] * 7


def test_a_lossy_wire_is_asked_again(rig):
    with can.Bus(interface="yam_sim", channel="follower_left", rig=rig.name) as bus:
        chain = MotorChain(bus, ARM, channel="follower_left")
        rig.fault("follower_left", 3, "drop_next", 4)
        assert chain.read_register(2, Register.TMAX) == 28.0
        rig.fault("follower_left", 3, "drop_next", 5)
        with pytest.raises(MotorError, match=r"motor joint3 \(id 3\) did not answer reading register TMAX"):
            chain.read_register(2, Register.TMAX)


def test_a_leader_has_a_handle():
    with can.Bus(interface="yam_sim", channel="leader_left") as bus:
        assert prepare_handle(bus, "leader_left")[1] == 0
        handle = HandleEncoder()
        chain = MotorChain(bus, ARM, channel="leader_left", encoder=handle)
        motor_inspection.verify(chain)
        exchange(chain, np.zeros((6, 5)), timeout_s=0.5)
        assert handle.stamp_s > 0
        assert handle.lost == 0


def test_a_second_driver_on_the_wire_is_heard():
    with (
        can.Bus(interface="yam_sim", channel="follower_left") as ours,
        can.Bus(interface="yam_sim", channel="follower_left") as theirs,
    ):
        other = MotorChain(theirs, ARM, channel="follower_left")
        stop = threading.Event()

        def poll():
            while not stop.wait(0.002):
                other.refresh()

        thread = threading.Thread(target=poll)
        thread.start()
        try:
            with pytest.raises(ChannelInUseError, match="follower_left.*0x7FF"):
                motor_inspection.listen(ours, 0.2, range(1, 8), "follower_left")
        finally:
            stop.set()
            thread.join()
