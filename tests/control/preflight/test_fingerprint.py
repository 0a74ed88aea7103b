"""What answers on a channel of the rig, read over frames; the adapter as the kernel lists it."""

import can

from lerobot_robot_yam.arm.mounting import arm_ids
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.preflight.fingerprint import Adapter, adapter_of, read_fingerprint
from tests.support.doctor_desk import Sysfs

READ_ONLY = {0x7FF, 0x50E}


def look(rig, channel):
    with can.Bus(interface="yam_sim", channel=channel, rig=rig.name) as bus:
        return read_fingerprint(bus, channel, "yam_sim", arm_ids(load_arm("yam")))


def test_a_follower_and_a_leader_are_read_without_any_command(rig):
    for channel in ("follower_left", "leader_left"):
        rig.trace_start(channel)
    found, other = look(rig, "follower_left"), look(rig, "leader_left")
    assert [m.kind for m in found.motors.values()] == ["DM4340"] * 3 + ["DM4310"] * 4
    assert found.handle_firmware is None and "follower" in found.role(7)
    assert other.handle_firmware == (2, 4, 0) and "leader" in other.role(7)
    assert sorted(other.motors) == [1, 2, 3, 4, 5, 6]
    assert len(set(found.serials.values()) | set(other.serials.values())) == 13
    for channel in ("follower_left", "leader_left"):
        sent = {ident for _, _, ident, _ in rig.trace(channel)}
        assert sent and sent <= READ_ONLY


def test_a_motor_that_is_silent_is_missing_not_invented(rig):
    rig.fault("follower_left", "joint_4", "silent")
    assert sorted(look(rig, "follower_left").motors) == [1, 2, 3, 5, 6, 7]


def test_the_adapter_is_read_from_the_kernel(tmp_path):
    sysfs = Sysfs(tmp_path)
    sysfs.adapter("can0", "1-2.3", serial="004A0031")
    sysfs.adapter("can1", "1-2.4")
    sysfs.adapter("can2", "1-5", serial="TWIN", dev_port="1", number="0x1")
    sysfs.adapter("can4", "1-6", serial="OLD", number="0x1")  # as kernels until 2025 have it
    spi, vcan = tmp_path / "devices/spi0/spi0.0", tmp_path / "class/net/vcan0"
    for interface in (spi / "net/can3", vcan):
        interface.mkdir(parents=True)
        (interface / "type").write_text("280\n")
    (spi / "net/can3/device").symlink_to(spi)
    (tmp_path / "class/net/can3").symlink_to(spi / "net/can3")
    assert adapter_of("can0", tmp_path) == Adapter("004A0031", "1-2.3:1.0")
    assert adapter_of("can1", tmp_path) == Adapter(None, "1-2.4:1.0")
    assert adapter_of("can2", tmp_path) == Adapter("TWIN", "1-5:1.0/1")
    assert adapter_of("can4", tmp_path) == Adapter("OLD", "1-6:1.0/1")
    assert adapter_of("can3", tmp_path) == Adapter(None, "spi0.0")
    assert adapter_of("vcan0", tmp_path) is None
    assert adapter_of("can9", tmp_path) is None
