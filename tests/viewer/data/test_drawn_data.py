"""What the page draws of a data set: curves, the flags."""

import numpy as np

from lerobot_robot_yam.face.datasets.check.flags import Flag, Kind
from lerobot_robot_yam.face.datasets.check.opened_dataset import ACTION, STATE, RecordedEpisode
from lerobot_robot_yam.viewer.data.episode_list import describe
from lerobot_robot_yam.viewer.data.episode_player import curves

NAMES = {STATE: ["a", "b"], ACTION: ["b"]}


def episode(number, length):
    state = np.stack([np.arange(length), 10.0 * np.arange(length)], axis=1)
    return RecordedEpisode(number, {}, {STATE: state, ACTION: -state[:, 1:], "frame_index": np.arange(length)}, {})


def test_curves_of_one_value():
    times, state, action, compared, now = curves(NAMES, "b", 7, episode(0, 20), None, 10)
    assert np.allclose(times, np.arange(20) / 10)
    assert np.allclose(state, 10.0 * np.arange(20)) and np.allclose(action, -state)
    assert np.isnan(compared).all()
    assert np.flatnonzero(~np.isnan(now)).tolist() == [7] and now[7] == state[7]


def test_curves_of_a_value_without_action_beside_a_shorter_episode():
    _, state, action, compared, _ = curves(NAMES, "a", 0, episode(0, 20), episode(1, 12), 10)
    assert np.isnan(action).all()
    assert np.array_equal(compared[:12], state[:12]) and np.isnan(compared[12:]).all()


def test_curves_of_a_long_episode_have_no_more_points_than_can_be_seen():
    times, _, _, _, now = curves(NAMES, "b", 19_999, episode(0, 20_000), None, 10)
    assert len(times) == 600 and times[-1] == 1999.9 and not np.isnan(now[-1])


def test_flags_are_told_with_their_frames_and_nothing_of_them_is_markup():
    text = describe([Flag(Kind.CAMERA_FROZEN, "top: <b> stands", (3, 9))])
    assert "camera_frozen" in text and "&lt;b&gt; stands (frames 3–9)" in text and "look" not in describe([])
    assert "not checked" in describe(None) and "nothing" in describe([])
