"""What the rig's pictures show, through its renderer: shadows and grain, views, and looks by seed."""

import contextlib

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.rig.lockstep.lockstep_cameras import LockstepCamera
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.operator.script import make_setup
from lerobot_robot_yam.rig.world.world_model import build_world

SIZE = 160, 120


@contextlib.contextmanager
def shown(scene=None, **options):
    """A rig, and a function that returns a picture of a camera, of int."""
    rig, cameras = LockstepRig(scene, camera_noise=0.0, **options), {}

    def look(camera="top"):
        if camera not in cameras:
            cameras[camera] = LockstepCamera(rig, camera, *SIZE, 30)
            cameras[camera].connect()
        rig.sleep(0.002)
        return cameras[camera].latest()[0].astype(int)

    try:
        yield rig, look
    finally:
        rig.close()


def pixel(rig, camera, point_m):
    """Column and row at which a camera that stands in the world sees a point."""
    model = build_world(rig.device.scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    index = model.camera(camera).id
    x, y, z = data.cam_xmat[index].reshape(3, 3).T @ (np.asarray(point_m) - data.cam_xpos[index])
    scale = SIZE[1] / 2 / np.tan(np.radians(model.cam_fovy[index]) / 2)
    return SIZE[0] / 2 - scale * x / z, SIZE[1] / 2 + scale * y / z


def red(picture):
    r, g, b = np.moveaxis(picture, 2, 0)
    return (r > 120) & (g < 90) & (b < 90)


@pytest.fixture
def usual():
    with shown() as found:
        yield found


def shadow(rig, look, camera):
    """Where the cube's shadow is, against where the light throws it: pixels that are darker, their mean's offset."""
    cube = np.array([0.5, 0.1, 0.25])
    rig.place("cube", [0.3, -0.28, 0.02])
    without = look(camera)
    rig.place("cube", cube)
    light = build_world(rig.device.scene).light_dir[0]
    expected = np.array(pixel(rig, camera, cube - cube[2] / light[2] * light))
    rows, columns = np.nonzero((without - look(camera)).min(axis=2) > 15)
    found = np.column_stack([columns, rows])
    found = found[np.hypot(*(found - expected).T) < 12]
    return len(found), np.hypot(*(found.mean(axis=0) - expected)) if len(found) else np.inf


@pytest.mark.long
def test_a_things_shadow_lies_where_the_light_throws_it(usual):
    for camera in ("top", "front"):
        count, off = shadow(*usual, camera)
        assert count > 10 and off < 2.5, camera


@pytest.mark.long
def test_plain_pictures_have_neither_shadow_nor_grain(usual):
    def table(look):
        return look()[50:70, 70:90].std(axis=(0, 1)).max()  # between the arms

    with shown(pictures="plain") as (rig, look):
        assert shadow(rig, look, "top")[0] == 0
        assert table(look) < 2.0 < table(usual[1])


@pytest.mark.long
def test_the_top_camera_sees_every_place_and_left_is_left(usual):
    rig, look = usual
    for place in rig.scene()["places"].values():
        rig.place("cube", place)
        rows, columns = np.nonzero(red(look()))
        column, row = pixel(rig, "top", place)
        assert len(rows) > 12 and abs(columns.mean() - column) < 3 and abs(rows.mean() - row) < 3
        assert np.sign(SIZE[0] / 2 - column).round() == np.sign(place[1]) or abs(place[1]) < 0.01


@pytest.mark.long
def test_a_wrist_camera_sees_the_cube_and_the_finger_tips(usual):
    """They are what it is for; the gripper's palm would hide the table."""
    rig, look = usual
    setup = make_setup(rig.scene(), "pick_and_place")
    cube = np.array(rig.scene()["places"]["A"])
    rig.place("cube", cube.tolist())
    planner = setup.planners["left"]
    for rise_m in (0.1, 0.0):
        q = planner.pose(cube + [0.0, 0.0, rise_m], planner.grasp_yaw(cube, 0.0))
        rig.set_pose("follower_left", q.tolist(), 1.0)
        picture = look("wrist_left")
        rows, _ = np.nonzero(red(picture))
        assert len(rows) > 200 and 0 < rows.min() and rows.max() < SIZE[1] - 1, "the whole cube"
        dark = picture.max(axis=2) < 50
        assert dark[:, : SIZE[0] // 2].sum() > 200 and dark[:, SIZE[0] // 2 :].sum() > 200, "both fingers"
        assert (picture.min(axis=2) > 190).mean() < 0.02, "not the bright palm"
        assert dark.mean() < 0.35


def lift_pictures(seeds, **options):
    """Pictures of the task's table with the cube at one place, at these seeds one after the other."""
    with shown("lift_and_place", **options) as (rig, look):
        found = []
        for seed in seeds:
            rig.restart()
            rig.task("lift_and_place", seed=seed)
            rig.place("cube", [0.3, 0.3, 0.0225])
            rig.set_pose("follower_left", [0.0, 1.0, 1.0, 0.0, 0.0, 0.0], 1.0)
            found.append(look("top"))
        return found


@pytest.mark.long
def test_a_seed_has_the_same_pictures_again_and_another_seed_others():
    first, second, third = lift_pictures((3, 4, 3), randomise_look=1.0)
    assert np.array_equal(first, third)
    assert (np.abs(first - second) > 5).mean() > 0.3
    assert np.array_equal(lift_pictures((3,), randomise_look=1.0)[0], first)  # in another rig


@pytest.mark.long
def test_before_any_task_the_rigs_own_seed_draws_the_look():
    def picture(seed):
        with shown(randomise_look=1.0, seed=seed) as (_, look):
            return look()

    assert (np.abs(picture(2) - picture(1)) > 5).mean() > 0.3


def test_looks_change_no_motion():
    def motion(**options):
        with contextlib.closing(LockstepRig("lift_and_place", **options)) as rig:
            rig.task("lift_and_place", seed=3)
            rig.sleep(0.3)
            return rig.device.world.data.qpos.copy()

    usual = motion()
    assert np.array_equal(motion(randomise_look=1.0), usual) and np.array_equal(motion(pictures="plain"), usual)
