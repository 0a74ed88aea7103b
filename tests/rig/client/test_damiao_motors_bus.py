"""LeRobot's own driver as a client: the rig is not tuned to ours."""

import time

import pytest
from lerobot.motors import Motor, MotorNormMode
from lerobot.motors.damiao import DamiaoMotorsBus

from lerobot_robot_yam.rig.control import running_rig

pytestmark = pytest.mark.alone

TYPES = ["dm4340_48v"] * 3 + ["dm4310"] * 4  # LeRobot's rows with the ranges of the arm's motors


@pytest.fixture
def bus(monkeypatch):
    with running_rig(friction=0, arms=["follower_right"]) as rig:
        monkeypatch.setenv("YAM_RIG", rig.name)
        motors = {
            f"joint_{i}": Motor(id=i, model=kind, norm_mode=MotorNormMode.DEGREES, motor_type_str=kind, recv_id=i + 16)
            for i, kind in enumerate(TYPES, 1)
        }
        bus = DamiaoMotorsBus("follower_right", motors, can_interface="yam_sim", use_can_fd=False)
        yield bus, rig
        if bus.is_connected:
            bus.disconnect()


def test_it_opens_enables_reads_and_moves(bus):
    bus, rig = bus
    bus.connect()
    joints = list(bus.motors)
    assert all(motor["enabled"] for motor in rig.state()["arms"]["follower_right"]["motors"].values())
    before = bus.sync_read("Present_Position")
    assert before["joint_1"] == pytest.approx(0, abs=0.1)
    bus.sync_write("Kp", {**dict.fromkeys(joints[:3], 60), **dict.fromkeys(joints[3:], 10)})
    bus.sync_write("Kd", {**dict.fromkeys(joints[:3], 4), **dict.fromkeys(joints[3:], 1)})
    goal = {"joint_1": 20.0, "joint_2": 30.0, "joint_3": 30.0, "joint_4": 0.0, "joint_5": 0.0, "joint_6": 15.0}
    goal["joint_7"] = before["joint_7"]
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        bus.sync_write("Goal_Position", goal)
    states = bus.sync_read_all_states()
    true = rig.state()["arms"]["follower_right"]
    for i, joint in enumerate(joints[:6]):
        assert states[joint]["position"] == pytest.approx(57.2958 * true["q"][i], abs=0.5)
    assert states["joint_1"]["position"] == pytest.approx(20.0, abs=1.0)
    assert states["joint_6"]["position"] == pytest.approx(15.0, abs=1.0)
    assert states["joint_2"]["position"] > 20.0  # sags a little: no gravity compensation here
    bus.disconnect()
    motors = rig.state()["arms"]["follower_right"]["motors"].values()
    assert not any(motor["enabled"] for motor in motors)
