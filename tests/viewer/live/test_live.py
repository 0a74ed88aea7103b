"""The live part of the page, on a server without a browser."""

import contextlib

import numpy as np

from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.live.live import Live
from lerobot_robot_yam.viewer.serving.page import Page
from tests.viewer.live.test_watched_arms import KEY, session


def test_an_arm_whose_session_has_begun_anew_between_two_looks_stands_at_its_place():
    with contextlib.closing(Page(port=0)) as page, contextlib.closing(Live(page.server)) as live:
        for now_s in (1.0, 2.0):
            with session() as publish:
                publish(Mode.HOLD)
                live.update(now_s)
                assert np.allclose(live.place_of(KEY)[0], 0.0)
                publish(Mode.OFF)
