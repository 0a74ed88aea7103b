"""A data set of 200 episodes of 1,000 frames with three cameras: the page opens it at once, and checks it behind that.

`-s` shows how long that took, and how long the whole command; docs/measured.md has the figures.
"""

import contextlib
import sys
import time

import pytest

from lerobot_robot_yam.viewer.data.data_part import DataPart
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support import big_sets
from tests.support.browser import yam_view

pytestmark = [pytest.mark.long, pytest.mark.alone, pytest.mark.timeout(900)]

EPISODES, FRAMES, FPS = 200, 1000, 30


def test_a_large_data_set_is_opened_at_once_and_checked(tmp_path):
    root = big_sets.write(tmp_path / "data", EPISODES, FRAMES, FPS)
    started_s = time.monotonic()
    with yam_view("--dataset", str(root)):
        addressed_s = time.monotonic() - started_s
    with contextlib.closing(Page(port=0)) as page:
        begun_s = time.monotonic()
        with contextlib.closing(DataPart(page.server, root)) as part:
            part.update(time.monotonic())
            assert part._list._table.content.count("<tr") == 1 + EPISODES
            opened_s = time.monotonic()
            part._number.value = EPISODES - 1
            while not part._check.done:
                part.update(time.monotonic())
                time.sleep(0.05)
            took_s = time.monotonic() - opened_s
            report = part._check.report
            assert len(report.episodes) == EPISODES and not part._check.trouble
            assert not report.flagged and not report.flags, (report.flags, report.flagged[:3])
    rate = EPISODES * FRAMES / FPS / took_s
    sys.stdout.write(
        f"the command printed its address after {addressed_s:.2f} s; "
        f"opened in {opened_s - begun_s:.2f} s, checked in {took_s:.0f} s: {rate:.0f} x real time"
    )
