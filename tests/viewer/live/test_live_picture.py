"""The page with two followers at work, two leaders and three open cameras, in a real browser.

YAM_DOCS_PICTURE=docs/view_live.png has the test write its picture there.
"""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.workspace import KeepOut, WorkspaceConfig
from lerobot_robot_yam.rig.client.rendered_camera import RigCamera
from lerobot_robot_yam.rig.control import running_rig
from tests.support.browser import browser_page, take_picture, yam_view
from tests.support.rigged import session_on, sim_config, track

FOLLOWERS, LEADERS = ("follower_left", "follower_right"), ("leader_left", "leader_right")
CAMERAS = ("top", "wrist_left", "wrist_right")
POSES = {"follower_left": [0.3, 1.1, 1.2, -0.5, 0.0, 0.2], "follower_right": [-0.2, 1.3, 1.0, 0.3, 0.2, 0.0]}
SIZE = (1600, 1000)


@contextlib.contextmanager
def at_work():
    """Four arms: the followers go to POSES and back, within a workspace."""
    mast = KeepOut(name="mast", center_m=[0.45, 0.0, 0.35], size_m=[0.06, 0.06, 0.7])
    with running_rig() as rig, contextlib.ExitStack() as stack:
        rows = [row for row in rig.scene()["arms"] if row["channel"] in FOLLOWERS]
        places = {row["channel"]: row["position_m"] for row in rows}
        limits = {
            channel: WorkspaceConfig(base_position_m=place, floor_z_m=0.0, keep_out=[mast], collision_margin_m=0.02)
            for channel, place in places.items()
        }
        followers = session_on(rig, *(sim_config(rig, name, workspace=limits[name]) for name in FOLLOWERS))
        leaders = session_on(rig, *(sim_config(rig, name) for name in LEADERS))
        for session in (followers, leaders):
            stack.callback(session.stop)
            session.start()
        for camera in CAMERAS:
            stack.enter_context(RigCamera(camera, 320, 240, 15, rig=rig.name))
        yield rig, followers


@pytest.mark.long
@pytest.mark.alone
def test_the_page_as_docs_show_it(tmp_path):
    errors = []
    with at_work() as (rig, followers), yam_view() as url, browser_page(url, errors, *SIZE) as page:
        for name in (*FOLLOWERS, *LEADERS):
            page.get_by_text(name).first.wait_for()
        track(followers, POSES, 6.0, gripper=0.8)
        track(followers, {name: np.array(pose) + 0.25 for name, pose in POSES.items()}, 1.0, gripper=0.2)
        scene = np.asarray(take_picture(page, tmp_path))[:, : SIZE[0] // 2]
    assert not errors
    assert len(np.unique(scene.reshape(-1, 3), axis=0)) > 1000  # arms, table and pictures, not one colour
