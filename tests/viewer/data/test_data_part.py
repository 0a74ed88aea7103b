"""The data part on a server without a browser: where a played episode is, what it opens, shows and lets go of."""

import contextlib
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.viewer.data.data_part import DataPart
from lerobot_robot_yam.viewer.data.episode_player import Playhead
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support import big_sets
from tests.support.seeded_sets import edit_rows

EPISODES, FRAMES = 3, 60


@pytest.fixture
def page():
    page = Page(port=0)
    yield page
    page.close()


@pytest.fixture
def root(tmp_path):
    """Three episodes without pictures: the second one jumps."""
    root = big_sets.write(tmp_path / "data", EPISODES, FRAMES, cameras=())

    def jump(columns):
        columns["action"][FRAMES + 30 : 2 * FRAMES, 1] += 0.6

    edit_rows(root, jump)
    return root


@contextlib.contextmanager
def part_on(page, root, **options):
    part = DataPart(page.server, root, **options)
    try:
        yield part
    finally:
        part.close()


def looked_at(part, seconds=10.0):
    """Update it until the check has ended, and what it says is shown."""
    begin = time.monotonic()
    while not part._check.done:
        assert time.monotonic() < begin + seconds
        part.update(time.monotonic())
        time.sleep(0.02)
    part.update(time.monotonic() + 1.0)


def poses(figures):
    return [[link.position.copy() for _, link in figure._links] for figure in figures._figures]


def test_the_table_is_there_at_once_and_the_check_fills_it(page, root):
    outcomes.append(root, [outcomes.now(0, "success", "a test"), outcomes.now(2, "failure", "a test")])
    with part_on(page, root) as part:
        part.update(0.0)
        assert part._list._table.content.count("<tr") == 1 + EPISODES
        looked_at(part)
        rows = part._list._table.content.split("<tr")[2:]
        assert ["success" in row for row in rows] == [True, False, False]
        assert ["action_jump" in row for row in rows] == [False, True, False]
        assert "1 of 3 episodes have flags" in part._list._said.content
        part._list._filter.value = "flagged"
        part.update(time.monotonic() + 2.0)
        assert part._list._table.content.count("<tr") == 2


def test_the_figures_follow_the_slider_and_play_to_the_end(page, root):
    with part_on(page, root) as part:
        part.update(0.0)
        before = poses(part._figures)
        part._slider.value = 30
        part.update(0.1)
        assert not np.allclose(before, poses(part._figures))
        part._toggle()
        part.update(10.0)
        part.update(10.5)
        assert part._slider.value == 45 and part._playhead.playing
        part.update(20.0)
        assert part._slider.value == FRAMES - 1 and not part._playhead.playing


def test_two_episodes_are_compared_and_a_flag_is_gone_to(page, root):
    with part_on(page, root) as part:
        looked_at(part)
        assert part._figures.visible and not part._ghosts.visible
        part._number.value, part._other.value = 1, 2
        part.update(time.monotonic())
        assert part._ghosts.visible and not np.allclose(poses(part._figures), poses(part._ghosts))
        assert "action_jump" in part._said.content
        part._go_to_flag()
        part.update(time.monotonic())
        assert part._slider.value == 29
        part._in_3d.value = False
        part.update(time.monotonic())
        assert not part._figures.visible and not part._ghosts.visible


def test_a_labelled_copy_tells_its_outcomes(page, root):
    (path,) = (root / "meta" / "episodes").rglob("*.parquet")
    table = pq.read_table(path)
    pq.write_table(table.append_column("success", pa.array([True, None, False])), path)
    with part_on(page, root) as part:
        assert part._list._labels == {0: "success", 2: "failure"}


def test_what_is_no_data_set_or_of_other_arms_is_refused(page, root, tmp_path):
    with pytest.raises(ConfigError, match=r"info\.json"):
        DataPart(page.server, tmp_path)
    seven = ArmConfig(channel="a", arm="none", gripper="linear_4310")
    with pytest.raises(ConfigError, match="6 joints"):
        DataPart(page.server, root, known={"left_": seven})


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
