"""Pictures of cameras that somebody has opened."""

import numpy as np
import pytest

from lerobot_robot_yam.rig.client.rendered_camera import frame_dtype, frame_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from lerobot_robot_yam.viewer.live.rendered_pictures import RenderedPictures


@pytest.fixture
def pictures():
    pictures = RenderedPictures("drawn")
    yield pictures
    pictures.close()


def opened(camera, width, height):
    """What the renderer has of an open camera, and a way to have it draw a grey picture."""
    dtype = frame_dtype(width, height)
    block = SharedBlock(frame_path("drawn", camera, width, height, 30), dtype, create=True)

    def draw(grey):
        record = np.zeros((), dtype)
        record["rgb"] = grey
        block.write(record)

    return block, draw


def test_each_picture_is_given_once_and_no_wider_than_a_frustum_needs(pictures):
    block, draw = opened("top", 640, 480)
    pictures.look()
    assert pictures.is_open("top") and pictures.newest("top") is None
    draw(100)
    picture = pictures.newest("top")
    assert picture.shape == (240, 320, 3) and (picture == 100).all()
    assert pictures.newest("top") is None
    draw(50)
    assert (pictures.newest("top") == 50).all()
    block.close()


def test_a_camera_that_is_closed_is_forgotten_and_one_of_a_similar_name_is_another(pictures):
    block, draw = opened("wrist-left", 32, 24)
    draw(1)
    pictures.look()
    assert pictures.is_open("wrist-left") and not pictures.is_open("wrist")
    block.close()
    pictures.look()
    assert not pictures.is_open("wrist-left") and pictures.newest("wrist-left") is None
