"""Cables plugged the other way round: a session refuses by name, before anything is energised."""

import can
import pytest

from lerobot_robot_yam.arm.mounting import arm_ids
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.preflight.binding import Binding
from lerobot_robot_yam.control.preflight.fingerprint import read_fingerprint
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.arm_session import ArmSession
from tests.support.rigged import sim_config

pytestmark = pytest.mark.alone

FOLLOWERS = ("follower_left", "follower_right")


def bind(rig, channel, path):
    with can.Bus(interface="yam_sim", channel=channel, rig=rig.name) as bus:
        Binding(path.stem, channel, read_fingerprint(bus, channel, "yam_sim", arm_ids(load_arm("yam")))).save(path)


def enabled(rig):
    return [m for arm in rig.state()["arms"].values() for m in arm["motors"].values() if m["enabled"]]


def bound(rig, directory):
    return ArmSession([sim_config(rig, c, identity_path=str(directory / f"{c}_arm.json")) for c in FOLLOWERS])


def test_swapped_followers_are_named_and_not_driven(tmp_path):
    with running_rig() as rig:
        for channel in FOLLOWERS:
            bind(rig, channel, tmp_path / f"{channel}_arm.json")
        session = bound(rig, tmp_path)
        session.start()  # as they were bound
        session.stop()
    with running_rig(swapped="follower_left,follower_right") as rig:
        with pytest.raises(MotorError, match="(?s)follower_left.*'follower_right_arm'.*swapped"):
            bound(rig, tmp_path).start()
        assert not enabled(rig)


@pytest.mark.long
def test_a_binding_that_is_not_there_is_refused_before_anything_is_energised(rig, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    session = ArmSession([sim_config(rig, "follower_left", identity_path="~/left.json")])
    with pytest.raises(ConfigError, match=f"follower_left: there is no arm binding {tmp_path}/left.json.*--bind"):
        session.start()
    assert not enabled(rig)
    bind(rig, "follower_right", tmp_path / "left.json")  # another arm than the one that is there
    with pytest.raises(MotorError, match="follower_left does not carry the arm bound as 'left'"):
        session.start()
    assert not enabled(rig)


def test_a_leader_on_a_followers_channel_is_named_without_any_binding(rig):
    session = ArmSession([sim_config(rig, "leader_left", gripper="linear_4310", start="hold")])
    with pytest.raises(MotorError, match="leader"):
        session.start()
    assert not enabled(rig)
