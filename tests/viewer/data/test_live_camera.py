"""Cameras that can be looked through."""

from lerobot_robot_yam.rig.client.launch import rig_path
from lerobot_robot_yam.rig.client.told_scene import tell_scene
from lerobot_robot_yam.viewer.data.live_camera import rig_cameras, running_rigs


def test_the_cameras_of_a_rig_are_known_and_one_that_was_killed_is_not_started():
    left = [rig_path("killed", suffix) for suffix in ("sock", "scene")]
    try:
        tell_scene("killed", None, {"arms": ["follower_left"]})
        left[0].touch()
        assert running_rigs() == ["killed"]
        assert {"killed: top", "killed: front"} <= set(rig_cameras("killed"))
        assert not rig_path("killed", "log").exists()
    finally:
        for path in left:
            path.unlink()
    assert rig_cameras("killed") == {}
