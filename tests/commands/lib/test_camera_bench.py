"""The search for an exposure, on rooms whose brightness follows from it as a sensor's does: in proportion, clipped."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_robot_yam.commands.lib.camera_bench import (
    CLOSE,
    MOST_CLIPPED,
    MOST_TRIES,
    TARGET,
    brightness_of,
    find_exposure,
)

D405 = (1, 165000)


def room(light, lamp=0.0, window=0.0):
    """A picture of a table in a light, at an exposure; `lamp`: its share; `window`: how bright the first tenth is."""
    table = np.random.default_rng(0).uniform(0.2, 1.0, (24, 32, 1)) * np.ones(3)
    table.reshape(-1, 3)[: round(lamp * table.size / 3)] = 100.0
    if window:
        table[:, :3] = window
    return lambda exposure: brightness_of(np.clip(255 * table * light * exposure, 0, 255).astype(np.uint8))


def test_brightness_of_a_picture():
    grey = np.full((10, 10, 3), 128, np.uint8)
    grey[0] = 255
    assert str(brightness_of(grey)) == "brightness 0.55, 10.0% clipped"


@settings(deadline=None, max_examples=30)
@given(exponent=st.floats(-4.5, -0.5))
def test_it_finds_the_target_in_any_light_that_the_range_covers(exponent):
    rows = find_exposure(room(10**exponent), D405)
    exposure, seen = rows[-1]
    assert len(rows) <= MOST_TRIES and D405[0] <= exposure <= D405[1]
    if 50 < TARGET / 10**exponent < D405[1] / 2:  # finer than its steps, and in its range
        assert abs(seen.mean - TARGET) <= CLOSE and seen.clipped <= MOST_CLIPPED


def test_clipping_counts_before_brightness():
    assert find_exposure(room(1e-4, lamp=0.01), D405)[-1][1].mean == pytest.approx(TARGET, abs=CLOSE)
    rows = find_exposure(room(1e-4, window=3.0), D405)
    assert rows[-1][1].clipped <= MOST_CLIPPED and TARGET / 2 < rows[-1][1].mean < TARGET - CLOSE
    brightest = max(rows, key=lambda row: row[0])[1]
    assert brightest.clipped > MOST_CLIPPED


def test_a_lamp_that_no_exposure_tames_does_not_make_the_rest_black():
    _, seen = find_exposure(room(1e-4, lamp=0.05), D405)[-1]
    assert seen.clipped > MOST_CLIPPED and TARGET / 2 - CLOSE < seen.mean < TARGET + 2 * CLOSE


@pytest.mark.parametrize("light, at", [(1e-9, D405[1]), (1e3, 1)])
def test_a_room_too_dark_or_too_bright_ends_at_the_limit(light, at):
    exposure, _ = find_exposure(room(light), D405)[-1]
    assert 0.5 < exposure / at < 8.0
