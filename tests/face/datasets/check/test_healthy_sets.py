"""The check finds nothing in healthy data sets, whatever odd things people do in them."""

import numpy as np
import pytest

from tests.support import seeded_sets as seeds
from tests.support.seeded_sets import FRAMES, JOINTS, RIGHT, found
from tests.support.tiers import spread


def resting(motions):
    """The right arm stays where it is to the last bit, its gripper too."""
    for action, state in motions:
        action[:, RIGHT] = state[:, RIGHT] = state[0, RIGHT]


def pausing(motions):
    """The leaders stop for a second; the followers come after."""
    for action, state in motions:
        action[20:40], state[22:40] = action[20], action[20]
        action[40:], state[40:] = action[20:40], action[20:40]


def waiting(motions):
    """For a second and a half nothing moves at all, as on the virtual rig; then the leaders are quick."""
    for action, state in motions:
        quick = 0.1 * np.maximum(np.arange(FRAMES) - 30, 0)[:, None]
        action[:], state[:] = action[0], action[0]
        action[:, JOINTS] += 0.6 * np.sin(quick + 0.3) - 0.6 * np.sin(0.3)
        state[:, JOINTS] = action[np.maximum(np.arange(FRAMES) - 2, 0)][:, JOINTS]


@pytest.mark.parametrize("habit", spread([None, resting, pausing, waiting], 0, 2))
def test_nothing_is_found_in_a_healthy_data_set(habit, tmp_path):
    motions = [seeds.motion(episode) for episode in range(2)]
    if habit:
        habit(motions)
    root = seeds.write(tmp_path / "data", motions, ("top", "right_wrist"))
    assert found(root, every_s=0) == found(root) == (set(), {})


def test_nothing_is_found_in_healthy_degrees(tmp_path):
    motions = [seeds.motion(episode, ("left_",)) for episode in range(2)]
    for values in (values for pair in motions for values in pair):
        values[:, :6] = np.degrees(values[:, :6])
        values[:, 6] = 0.3  # the gripper is not used
    names = [name.removeprefix("left_") for name in seeds.names(("left_",))]
    root = seeds.write(tmp_path / "data", motions, (), "yam_follower_degrees", names)
    assert found(root) == (set(), {})


def test_of_other_robots_only_what_their_names_tell_is_judged(tmp_path):
    values = 100 * np.random.default_rng(0).normal(size=(FRAMES, 2)).astype(np.float32)
    root = seeds.write(tmp_path / "data", [(values, values + 30)], (), "so101_follower", ["pan.pos", "gripper.pos"])
    assert found(root) == (set(), {})
