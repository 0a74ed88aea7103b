"""Pictures of a data set, one at a time."""

import contextlib

import av
import numpy as np
import pytest

from lerobot_robot_yam.errors import DatasetError
from lerobot_robot_yam.face.datasets.check.opened_dataset import STATE, open_dataset
from lerobot_robot_yam.face.datasets.dataset_pictures import DatasetPictures
from tests.support import big_sets, seeded_sets

TOP = "observation.images.top"


@pytest.fixture
def data(tmp_path):
    return open_dataset(big_sets.write(tmp_path / "data", 2, 40, cameras=["top"], size=(48, 64)))


@pytest.fixture
def pictures(data):
    with contextlib.closing(DatasetPictures(data)) as pictures:
        yield pictures


@pytest.mark.parametrize("frames", [[0, 17, 39], [39, 38, 1, 0]])
def test_a_picture_is_that_of_its_frame(data, pictures, frames):
    for frame in frames:
        seen = pictures.picture(data.episodes[0], TOP, frame)
        assert seen.shape == (48, 64, 3) and seen.dtype == np.uint8
        differences = [
            np.abs(seeded_sets.picture("top", state).astype(int) - seen).mean()
            for state in data.episodes[0].rows[STATE]
        ]
        assert np.argmin(differences) == frame


def test_the_picture_is_that_of_lerobot(data, pictures):
    from lerobot.datasets.video_utils import decode_video_frames

    path, start_s = data.clip(data.episodes[1], TOP)
    for frame in (0, 7, 39):
        theirs = decode_video_frames(path, [start_s + frame / data.fps], 1e-4, "pyav", return_uint8=True)
        np.testing.assert_array_equal(pictures.picture(data.episodes[1], TOP, frame), theirs[0].permute(1, 2, 0))


def test_distances_are_grey_and_near_ones_dark(data, pictures):
    path, _ = data.clip(data.episodes[0], TOP)
    distances = np.linspace(800, 3000, 48 * 64).astype(np.uint16).reshape(48, 64)
    with av.open(str(path), "w", format="matroska") as video:
        stream = video.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "gray12le"
        for _ in range(3):
            video.mux(stream.encode(av.VideoFrame.from_ndarray(distances, format="gray12le")))
        video.mux(stream.encode())
    data.features[TOP]["info"] = {"is_depth_map": True}
    seen = pictures.picture(data.episodes[0], TOP, 1)
    assert seen.shape == (48, 64, 3) and (seen == seen[..., :1]).all()
    assert seen[0, 0, 0] == 0 and seen[-1, -1, 0] == 255 and (np.diff(seen[..., 0].ravel().astype(int)) >= 0).all()


def test_a_picture_that_is_not_there_is_said(data, pictures):
    with pytest.raises(DatasetError, match="frame 500"):
        pictures.picture(data.episodes[0], TOP, 500)
    data.episodes[1].metadata.update({f"videos/{TOP}/file_index": 7})
    with pytest.raises(DatasetError, match="no video"):
        pictures.picture(data.episodes[1], TOP, 0)
