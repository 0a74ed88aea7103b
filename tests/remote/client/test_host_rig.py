"""The caller's side of a link: when it wakes the link process, which costs both a switch of programs."""

import select

import pytest

from lerobot_robot_yam.control.process.lifeline import Lifeline, take_nudges
from lerobot_robot_yam.remote.client.host_rig import RemoteRunner


@pytest.mark.parametrize(
    ("arms", "written", "nudges"),
    [
        (1, [0, 0, 0], [True, True, True]),
        (2, [0, 1, 0, 1], [False, True, False, True]),
        (2, [1, 0, 0, 1], [False, True, False, True]),
        (2, [0, 0, 0, 1], [False, True, True, True]),
    ],
)
def test_what_is_written_for_two_arms_wakes_it_once(arms, written, nudges):
    runner = RemoteRunner(None, list(range(arms)), [])
    runner._lifeline = lifeline = Lifeline()
    try:
        for arm, nudged in zip(written, nudges, strict=True):
            runner.note_written(arm)
            assert bool(select.select([lifeline.far_end], [], [], 0.0)[0]) is nudged
            if nudged:
                take_nudges(lifeline.far_end)
    finally:
        lifeline.close()
