"""Columns of a rollout's data set: whether a person has taken over an arm, and which one."""

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_strategy_yam.yam_dagger import _Episodes
from tests.support.strategy_here import HereConfig

FEATURES = {
    "observation.state": {"dtype": "float32", "shape": (1,), "names": ["a.pos"]},
    "action": {"dtype": "float32", "shape": (1,), "names": ["a.pos"]},
}
TAKEN = [set(), {"left_"}, {"right_"}, {"left_", "right_"}, {""}]


def recorded(root, features):
    """The data set of an episode with a frame for each of `TAKEN`."""
    dataset = LeRobotDataset.create("local/episodes", fps=30, features=features, root=root)
    episodes = _Episodes(dataset, FEATURES, "a task", 10)
    for taken in TAKEN:
        episodes.add({"a.pos": 0.1}, {"a.pos": 0.2}, taken)
    assert episodes.keep()
    dataset.finalize()
    return LeRobotDataset("local/episodes", root=root).hf_dataset.with_format("numpy")


@pytest.mark.parametrize("older", [False, True])
def test_each_frame_says_which_arms_a_person_drives(tmp_path, older):
    own = HereConfig().extra_dataset_features()
    if older:
        del own["intervention_arms"]  # a data set that an older version has begun
    table = recorded(tmp_path / "set", FEATURES | own)
    assert np.stack(table["intervention"]).ravel().tolist() == [bool(taken) for taken in TAKEN]
    if not older:
        arms = [[False, False], [True, False], [False, True], [True, True], [True, True]]
        assert np.stack(table["intervention_arms"]).tolist() == arms
