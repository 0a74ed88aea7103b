"""What answers on a channel of the rig, read over frames; the adapter as the kernel lists it."""

import can

from lerobot_robot_yam.arm.mounting import arm_ids
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.preflight.fingerprint import Adapter, read_adapter, read_fingerprint

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


def kernel(root, channel, device, serial=None, dev_port="0", dev_id="0x0"):
    """A network interface as sysfs shows it: links into a tree of devices."""
    home = root / "devices" / device
    (home / "net" / channel).mkdir(parents=True)
    if serial is not None:
        (home.parent / "serial").write_text(f"{serial}\n")
    (home / "net" / channel / "device").symlink_to(home)
    (home / "net" / channel / "dev_port").write_text(f"{dev_port}\n")
    (home / "net" / channel / "dev_id").write_text(f"{dev_id}\n")
    (root / "net").mkdir(exist_ok=True)
    (root / "net" / channel).symlink_to(home / "net" / channel)


def test_the_adapter_is_read_from_the_kernel(tmp_path):
    kernel(tmp_path, "can0", "usb1/1-2/1-2.3/1-2.3:1.0", "004A0031")
    kernel(tmp_path, "can1", "usb1/1-2/1-2.4/1-2.4:1.0", None)
    kernel(tmp_path, "can2", "usb1/1-5/1-5:1.0", "TWIN", dev_port="1", dev_id="0x1")
    kernel(tmp_path, "can4", "usb1/1-6/1-6:1.0", "OLD", dev_id="0x1")  # as kernels until 2025 have it
    kernel(tmp_path, "can3", "spi0/spi0.0")
    (tmp_path / "net" / "vcan0").mkdir()
    assert read_adapter("can0", tmp_path / "net") == Adapter("004A0031", "1-2.3:1.0")
    assert read_adapter("can1", tmp_path / "net") == Adapter(None, "1-2.4:1.0")
    assert read_adapter("can2", tmp_path / "net") == Adapter("TWIN", "1-5:1.0/1")
    assert read_adapter("can4", tmp_path / "net") == Adapter("OLD", "1-6:1.0/1")
    assert read_adapter("can3", tmp_path / "net") == Adapter(None, "spi0.0")
    assert read_adapter("vcan0", tmp_path / "net") is None
    assert read_adapter("can9", tmp_path / "net") is None
