"""Figures of an episode: what came late, twice or slower than the data set says."""

import numpy as np
import pytest

from lerobot_robot_yam.face.recorder.episode_log import EpisodeFigures


def recorded(times_s, images=None, fps=30):
    figures = EpisodeFigures(3, fps, "2026-01-01T00:00:00+00:00")
    for index, now_s in enumerate(times_s):
        figures.add_frame(now_s, {"top": images[index] if images else np.full((4, 4, 3), index)}, held_back=index < 3)
    return figures


def test_a_punctual_episode_says_its_rate_and_no_more():
    figures = recorded(100.0 + np.arange(300) / 30)
    figures.held_back = 0
    assert figures.summary() == "episode 3: 300 frames at 30.0 of 30 fps"
    assert not figures.slow


def test_a_slow_episode_is_told():
    figures = recorded(np.arange(100) / 20)
    assert figures.slow and figures.achieved_fps == pytest.approx(20.0)
    assert "at 20.0 of 30 fps" in figures.summary()


def test_one_late_frame_is_counted_and_kept():
    times = np.arange(60) / 30
    times[30:] += 0.1
    figures = recorded(times)
    assert "1 late (longest 133 ms)" in figures.summary()
    row = figures.row()
    assert row["late_frames"] == 1 and row["times_s"][30] == pytest.approx(1.1, abs=1e-3)


def test_an_image_that_comes_twice_is_counted():
    first, second = np.zeros((48, 64, 3), np.uint8), np.zeros((48, 64, 3), np.uint8)
    second[17, 5] = 200  # between the samples
    figures = recorded(np.arange(4) / 30, [first, first.copy(), second, second.copy()])
    assert figures.row()["repeated_images"] == {"top": 2}
    assert "2 repeated images of top" in figures.summary()


def test_an_empty_episode_has_figures():
    figures = recorded([])
    assert figures.row()["frames"] == 0 and not figures.slow


def test_one_frame_has_no_rate():
    assert recorded([7.0]).summary() == "episode 3: 1 frame, 100% of frames at the speed limit"
