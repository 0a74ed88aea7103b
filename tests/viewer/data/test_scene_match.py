"""A picture of a data set over what a camera sees now, and the cameras that can be looked through."""

import numpy as np

from lerobot_robot_yam.rig.client.launch import rig_path, tell_scene
from lerobot_robot_yam.viewer.data.scene_match import overlaid, rig_cameras, running_rigs


def test_an_overlay_has_the_size_of_the_live_picture_and_the_share_that_was_asked_for():
    live, recorded = np.full((40, 60, 3), 200, np.uint8), np.full((20, 20, 3), 100, np.uint8)
    for alpha, level in ((0.0, 200), (0.25, 175), (1.0, 100)):
        both = overlaid(live, recorded, alpha)
        assert both.shape == live.shape and both.dtype == np.uint8 and (both == level).all()


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
