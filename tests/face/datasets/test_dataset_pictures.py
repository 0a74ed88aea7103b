"""Pictures of a data set, one at a time."""

import numpy as np
import pytest

from lerobot_robot_yam.face.datasets.check.opened_dataset import STATE, open_dataset
from lerobot_robot_yam.face.datasets.dataset_pictures import picture
from lerobot_robot_yam.face.datasets.repair.dataset_on_disk import DatasetError
from tests.support import big_sets, seeded_sets

TOP = "observation.images.top"


@pytest.fixture
def data(tmp_path):
    return open_dataset(big_sets.write(tmp_path / "data", 2, 40, cameras=["top"], size=(48, 64)))


@pytest.mark.parametrize("frame", [0, 17, 39])
def test_a_picture_is_that_of_its_frame(data, frame):
    seen = picture(data, data.episodes[0], TOP, frame)
    assert seen.shape == (48, 64, 3) and seen.dtype == np.uint8
    differences = [
        np.abs(seeded_sets.picture("top", state).astype(int) - seen).mean() for state in data.episodes[0].rows[STATE]
    ]
    assert np.argmin(differences) == frame


def test_a_picture_that_is_not_there_is_said(data):
    with pytest.raises(DatasetError, match="frame 500"):
        picture(data, data.episodes[0], TOP, 500)
    data.episodes[1].metadata.update({f"videos/{TOP}/file_index": 7})
    with pytest.raises(DatasetError, match="no video"):
        picture(data, data.episodes[1], TOP, 0)
