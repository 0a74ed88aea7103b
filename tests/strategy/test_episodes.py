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


def test_the_frame_in_which_a_press_fell_has_the_executed_target_and_is_the_persons(tmp_path):
    """The press takes over in the control loop at once; the strategy learns of it one frame later."""
    dataset = LeRobotDataset.create(
        "local/episodes", fps=30, features=FEATURES | HereConfig().extra_dataset_features(), root=tmp_path / "set"
    )
    episodes = _Episodes(dataset, FEATURES, "a task", 10)
    episodes.correct({"a.pos": 9.0}, {""})  # before the first frame
    for action, pressed in [(0.2, set()), (0.3, set()), (0.7, {""}), (0.8, set())]:
        episodes.correct({"a.pos": action}, pressed)
        episodes.add({"a.pos": 0.1}, {"a.pos": action}, {""} if action > 0.5 else set())
    assert episodes.keep()
    dataset.finalize()
    table = LeRobotDataset("local/episodes", root=tmp_path / "set").hf_dataset.with_format("numpy")
    assert np.stack(table["action"]).ravel() == pytest.approx([0.2, 0.7, 0.7, 0.8])
    assert np.stack(table["intervention"]).ravel().tolist() == [False, True, True, True]
