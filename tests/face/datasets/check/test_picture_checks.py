"""Pictures are judged by what their camera has to show."""

import numpy as np

from lerobot_robot_yam.face.datasets.check.flags import Kind
from lerobot_robot_yam.face.datasets.check.motion_checks import ArmMotion
from lerobot_robot_yam.face.datasets.check.picture_checks import exposure, repeated, seen_arms, swapped
from lerobot_robot_yam.face.datasets.dataset_pictures import HEIGHT, WIDTH, Thumbnails

FPS = 10
MOVING, STILL = np.linspace(0, 2, 40)[:, None], np.zeros((40, 1))
LEFT, RIGHT = ArmMotion("left_", MOVING, MOVING), ArmMotion("right_", STILL, STILL)


def thumbnails(levels):
    levels = np.asarray(levels, np.uint8)
    return Thumbnails(np.arange(len(levels)), np.tile(levels[:, None, None], (1, HEIGHT, WIDTH)))


def test_a_wrist_camera_shows_its_own_arm():
    same = thumbnails([90] * 40)
    assert seen_arms("observation.images.right_wrist", [LEFT, RIGHT]) == [RIGHT]
    assert seen_arms("observation.images.wrist_left", [LEFT, RIGHT]) == [LEFT]
    assert seen_arms("observation.images.top", [LEFT, RIGHT]) == [LEFT, RIGHT]
    kinds = {
        name: [flag.kind for flag in repeated(name, same, [LEFT, RIGHT], FPS)] for name in ("wrist_left", "wrist_right")
    }
    assert kinds == {"wrist_left": [Kind.CAMERA_FROZEN], "wrist_right": []}


def test_pictures_that_differ_by_what_coding_makes_of_them_are_the_same():
    for levels, frozen in (([90, 93] * 20, True), ([90, 98] * 20, False), (range(90, 210, 3), False)):
        flags = list(repeated("top", thumbnails(levels), [LEFT], FPS))
        assert [flag.kind for flag in flags] == [Kind.CAMERA_FROZEN] * frozen


def test_a_dark_scene_is_not_black():
    night = thumbnails([6] * 10)
    night.images[:, 20:26, 20:26] = 120  # a lamp
    assert not list(exposure("top", night))
    assert [flag.kind for flag in exposure("top", thumbnails([6] * 10))] == [Kind.CAMERA_DARK]


def test_a_light_that_changes_is_no_swap():
    views = {number: {"a": np.full((4, 4), 50.0 + 30 * number), "b": np.full((4, 4), 150.0)} for number in range(3)}
    assert not list(swapped(views))
    views[2] = {"a": np.full((4, 4), 150.0), "b": np.full((4, 4), 80.0)}
    assert [(number, flag.kind) for number, flag in swapped(views)] == [(2, Kind.CAMERAS_SWAPPED)]
