"""Where a played episode is."""

import pytest

from lerobot_robot_yam.viewer.data.playhead import Playhead


@pytest.fixture
def playhead():
    head = Playhead(fps=10)
    head.open(100)
    return head


@pytest.mark.parametrize("speed", [0.1, 1.0, 2.0])
def test_it_moves_with_time_at_its_speed(playhead, speed):
    playhead.speed = speed
    playhead.seek(10)
    playhead.play()
    assert [playhead.advance(50.0), playhead.advance(52.06)] == [10, 10 + int(20.6 * speed)]


def test_it_stands_until_it_is_played_and_stops_at_the_end(playhead):
    assert [playhead.advance(0.0), playhead.advance(3.0)] == [0, 0]
    playhead.play()
    playhead.advance(3.0)
    assert playhead.advance(1000.0) == 99 and not playhead.playing
    playhead.play()  # from the start again
    assert playhead.advance(1001.0) == 0 and playhead.playing


def test_a_pause_costs_no_frames(playhead):
    playhead.play()
    playhead.advance(0.0)
    playhead.advance(1.0)
    playhead.pause()
    playhead.advance(9.0)
    playhead.play()
    assert [playhead.advance(9.1), playhead.advance(9.25)] == [10, 11]


def test_it_goes_no_further_than_there_are_frames(playhead):
    for asked, there in ((-5, 0), (7, 7), (1000, 99)):
        playhead.seek(asked)
        assert playhead.frame == there
    playhead.open(3)
    assert (playhead.frame, playhead.frames, playhead.playing) == (0, 3, False)
