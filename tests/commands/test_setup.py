"""yam-setup on the rig: what it finds, asks, draws and writes; again, after an interruption, and over another file."""

import os
import sys

import can
import pytest
import yaml

from lerobot_robot_yam.commands.handle import main as set_handle
from lerobot_robot_yam.commands.setup import main
from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import REGISTER_ID
from lerobot_robot_yam.rig.client.sim_bus import YamSimBus
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.records import channel_key, lock_path
from lerobot_robot_yam.system.runtime_files import FileLock
from tests.support.doctor_desk import Sysfs
from tests.support.terminal import Terminal
from tests.support.unnamed_rig import write_scene

CHANNELS = ("follower_left", "follower_right", "leader_left", "leader_right")


@pytest.fixture(scope="module")
def desk():
    """The default rig."""
    with running_rig() as rig:
        yield rig


def run(rig, path, *more):
    return main([str(path), "--yes", *more, f"--rig={rig.name}"])


def enabled(rig):
    return [c for c, arm in rig.state()["arms"].items() for motor in arm["motors"].values() if motor["enabled"]]


def test_a_rig_is_found_drawn_and_written_and_nothing_is_energised(desk, tmp_path, capsys):
    path = tmp_path / "lab.yaml"
    for channel in CHANNELS:
        desk.trace_start(channel)
    assert run(desk, path) == 0
    asked = {identifier for channel in CHANNELS for _, _, identifier, _ in desk.trace(channel)}
    assert asked == {REGISTER_ID, REQUEST_ID} and not enabled(desk)
    drawn = capsys.readouterr().out
    assert drawn.startswith(
        """\
rig lab
+-----------------+   +-----------------+
| left follower   |   | right follower  |
| follower_left   |   | follower_right  |
| yam             |   | yam             |
| linear_4310     |   | linear_4310     |
| gripper DM4310  |   | gripper DM4310  |
+-----------------+   +-----------------+
      ^ leads               ^ leads
+-----------------+   +-----------------+
| left leader     |   | right leader    |
| leader_left     |   | leader_right    |
"""
    )
    assert "camera top: yam_sim top, 320 x 240 at 30 Hz" in drawn
    document = yaml.safe_load(path.read_text())
    assert document["robot"]["type"] == "bi_yam_follower" and document["teleop"]["type"] == "bi_yam_leader"
    arms = [document[part][f"{side}_arm_config"] for part in ("robot", "teleop") for side in ("left", "right")]
    assert [arm["channel"] for arm in arms] == list(CHANNELS)
    assert list(document["robot"]["cameras"])[:3] == ["top", "wrist_left", "wrist_right"]
    assert not list(tmp_path.glob("*.answers"))
    before = path.read_text()
    assert run(desk, path) == 0
    assert "says so already" in capsys.readouterr().err and path.read_text() == before


def test_an_earlier_file_keeps_what_was_added_and_goes_only_after_a_question(desk, tmp_path, capsys):
    path, one = tmp_path / "rig.yaml", "--channel=follower_left"
    assert run(desk, path, one) == 0
    document = yaml.safe_load(path.read_text())
    document["robot"] |= {"gripper": "crank_4310", "workspace": {"floor_z_m": 0.0}}
    document["robot"]["cameras"] = {"old": {"type": "yam_sim", "camera": "top"}}
    by_hand = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    path.write_text(by_hand)
    assert run(desk, path, one, "--dry-run") == 0
    assert "-  gripper: crank_4310" in capsys.readouterr().out and path.read_text() == by_hand
    program = (sys.executable, "-m", "lerobot_robot_yam.commands.setup", str(path), one, f"--rig={desk.name}")
    with Terminal(tmp_path, *program) as terminal:
        terminal.answer(("[lab]:", b"no name\n"), ("'no name' is no name", b"\n" * 20), ("[Y/n]", b""))
        assert "-  workspace" not in terminal.shown
        terminal.type(b"n\n")
        assert terminal.end() in (0, 1)
    assert run(desk, path, one) == 0
    robot = yaml.safe_load(path.read_text())["robot"]
    assert robot["gripper"] == "linear_4310" and "old" not in robot["cameras"]
    assert robot["workspace"] == {"floor_z_m": 0.0}


def test_a_channel_in_use_is_told_with_its_process_and_too_few_arms_are_no_rig(desk, tmp_path, capsys):
    with FileLock(lock_path(channel_key("yam_sim", "leader_right", desk.name)), "leader_right"):
        assert run(desk, tmp_path / "rig.yaml") == 1
    said = capsys.readouterr().err
    assert "leader_right: left out:" in said and f"process {os.getpid()}" in said and "python" in said
    assert "2 followers and 1 leaders (0 without motors) are no rig" in said
    assert not list(tmp_path.iterdir())
    desk.fault("follower_right", None, "silent")
    assert run(desk, tmp_path / "rig.yaml", "--channel=follower_right") == 1
    desk.clear_faults("follower_right")
    said = capsys.readouterr().err
    assert "follower_right: nothing answers; check the arm's power" in said and "no arm was found" in said


def test_one_arm_and_its_leader(desk, tmp_path):
    path = tmp_path / "one.yaml"
    assert run(desk, path, "--channel=leader_left", "--channel=follower_right") == 0
    document = yaml.safe_load(path.read_text())
    assert (document["robot"]["type"], document["robot"]["channel"]) == ("yam_follower", "follower_right")
    assert (document["teleop"]["type"], document["teleop"]["channel"]) == ("yam_leader", "leader_left")


@pytest.mark.long
def test_what_is_wrong_is_named_and_what_we_can_repair_is_repaired(desk, tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    for motor in ("joint_1", "joint_2"):
        desk.fault("follower_left", motor, "register", 0, register=int(Register.TIMEOUT))
    desk.fault("follower_left", "joint_3", "silent")
    desk.trigger("leader_left", 0.3)
    channels = ("--channel=follower_left", "--channel=leader_left")
    assert run(desk, tmp_path / "rig.yaml", *channels, "--dry-run") == 0
    said = capfd.readouterr().err
    assert "follower_left motor joint_3 (id 3): no answer" in said
    assert "TIMEOUT is 0 instead of 8000" in said and "and 1 more like it" in said
    assert f"-> yam-motors timeout --channel follower_left --rig {desk.name} 0.4" in said
    assert "yam-handle zero" in said and "written, stored" not in said
    desk.clear_faults("follower_left")
    assert run(desk, tmp_path / "rig.yaml", *channels) == 0
    said = capfd.readouterr().err
    assert "Switch the arm's power off and on" in said and "the released trigger reads 0 now" in said
    assert run(desk, tmp_path / "rig.yaml", *channels) == 0
    assert "TIMEOUT" not in capfd.readouterr().err
    desk.trigger("leader_left", 0.0)
    assert set_handle(["zero", "--channel=leader_left", f"--rig={desk.name}", "--yes"]) == 0


@pytest.mark.long
def test_on_a_computer_adapters_and_cameras_are_those_of_the_kernel(tmp_path, monkeypatch, capsys):
    """The rig stands behind the interfaces that sysfs shows. The names of two say left and right, of two nothing."""
    sysfs = Sysfs(tmp_path / "sys")
    for port, channel in enumerate(("can_follower_l", "can_follower_r", "can_a", "can_b"), 1):
        sysfs.adapter(channel, f"1-{port}", serial=f"000{port}")
    sysfs.camera("video0", "2-1", "C920", vendor="046d")
    sysfs.camera("video1", "2-1", "C920", function="1.1", vendor="046d")
    sysfs.realsense("video2", "2-2", "5000")
    links = tmp_path / "dev/v4l/by-path"
    links.mkdir(parents=True)
    (links / "pci-0000:00:14.0-usb-0:1:1.0-video-index0").symlink_to("../../video0")
    monkeypatch.setitem(can.interfaces.BACKENDS, "socketcan", (YamSimBus.__module__, YamSimBus.__name__))
    names = dict(zip(CHANNELS, ("can_follower_l", "can_follower_r", "can_a", "can_b"), strict=True))
    path = tmp_path / "rig.yaml"
    with running_rig(scene=write_scene(tmp_path / "scene.yaml", names)) as rig:
        monkeypatch.setenv("YAM_RIG", rig.name)
        assert main([str(path), "--yes", f"--root={tmp_path}"]) == 0
    assert "can_a is the left leader, can_b the right one" in capsys.readouterr().err
    document = yaml.safe_load(path.read_text())
    assert document["robot"]["left_arm_config"] == {"channel": "can_follower_l", "arm": "yam", "gripper": "linear_4310"}
    cameras = document["robot"]["cameras"].values()
    assert [camera["type"] for camera in cameras] == ["opencv", "yam_realsense"]
    assert [camera.get("index_or_path", camera.get("serial_number_or_name")) for camera in cameras] == [
        f"{tmp_path}/dev/v4l/by-path/pci-0000:00:14.0-usb-0:1:1.0-video-index0",
        "123422070577",
    ]


def test_without_an_adapter_or_a_terminal_it_says_so(tmp_path, capsys, monkeypatch):
    (tmp_path / "sys/class/net").mkdir(parents=True)
    assert main([str(tmp_path / "rig.yaml"), "--yes", f"--root={tmp_path}"]) == 1
    assert "there is no CAN adapter; plug one in" in capsys.readouterr().err
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        assert main([str(tmp_path / "rig.yaml")]) == 1
    assert "no terminal" in capsys.readouterr().err


@pytest.mark.long
def test_leaders_without_motors_are_found(tmp_path, capsys):
    path = tmp_path / "rig.yaml"
    with running_rig(scene="passive_leaders") as rig:
        assert run(rig, path) == 0
    teleop = yaml.safe_load(path.read_text())["teleop"]
    assert teleop["type"] == "bi_yam_passive_leader" and teleop["left_arm_config"]["kind"] == "desk"
    assert "| desk station, follower yam |" in capsys.readouterr().out


@pytest.mark.long
def test_the_left_arms_are_shown_by_their_wrists_and_an_interrupted_set_up_goes_on(tmp_path):
    path = tmp_path / "rig.yaml"
    with running_rig(scene=write_scene(tmp_path / "scene.yaml")) as rig:
        program = (sys.executable, "-m", "lerobot_robot_yam.commands.setup", str(path), f"--rig={rig.name}")
        with Terminal(tmp_path, *program) as terminal:
            terminal.answer(("[lab]:", b"desk\n"), ("is the left follower", b""))
            q = rig.state()["arms"]["can2"]["q"]
            rig.lift("can2", [*q[:-1], q[-1] + 0.8], then_release=True)
            terminal.answer(
                ("can2 is the left follower, can0 the right one", b""),
                ("is the left leader", b"\x03"),
            )
            assert terminal.end() == 130
        assert not path.exists()
        with Terminal(tmp_path, *program) as terminal:
            terminal.answer(("going on with the answers in", b""), ("is the left leader", b""))
            assert "is the left follower, as you see" not in terminal.shown and "[lab]" not in terminal.shown
            terminal.answer(
                ("", b"can7\n"),
                ("'can7' is none of can3, can1", b"can3\n" + b"\n" * 6 + b"top\ntop\nwrist_left\n-\n"),
            )
            assert terminal.end() == 0
            assert "another camera is called top already" in terminal.shown
    robot = yaml.safe_load(path.read_text())["robot"]
    assert robot["id"] == "desk" and robot["left_arm_config"]["channel"] == "can2"
    assert {name: camera["camera"] for name, camera in robot["cameras"].items()} == {
        "top": "video4",
        "wrist_left": "video0",
    }


def test_a_base_is_found_and_its_rail(tmp_path, capsys):
    path = tmp_path / "base.yaml"
    with running_rig(scene="mobile", rail=True) as rig:
        assert run(rig, path) == 0
        said = capsys.readouterr()
        assert "| mobile base |" in said.out and "| with a rail |" in said.out and "yam-base check" in said.err
        assert not any(motor["enabled"] for motor in rig.state()["base"]["motors"].values())
    document = yaml.safe_load(path.read_text())
    robot = document["robot"]
    assert (robot["type"], robot["channel"], robot["rail"]) == ("yam_base", "base", {"io": "sim"})
    assert document["teleop"] == {"type": "yam_gamepad", "id": "lab"}
    assert main(["--check", str(path)]) == 0


def test_a_base_with_two_arms(tmp_path, capsys):
    path = tmp_path / "mobile.yaml"
    with running_rig(scene="mobile_tables") as rig:
        followers = [f"--channel={arm['channel']}" for arm in rig.scene()["arms"] if arm["role"] == "follower"]
        assert run(rig, path, *followers, "--channel=base") == 0
        assert run(rig, tmp_path / "one.yaml", followers[0], "--channel=base", "--dry-run") == 1
    assert "1 bases with 1 followers are no rig" in capsys.readouterr().err
    robot = yaml.safe_load(path.read_text())["robot"]
    assert (robot["type"], robot["base_config"]["channel"]) == ("yam_mobile", "base")
    assert {robot[f"{side}_arm_config"]["channel"] for side in ("left", "right")} == {"follower_left", "follower_right"}
    assert main(["--check", str(path)]) == 0
