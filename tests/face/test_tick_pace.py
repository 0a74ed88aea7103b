"""Rate and late ticks of a loop, counted from the times that it has noted."""

import pytest

from lerobot_robot_yam.face import session_desk
from lerobot_robot_yam.face.session_desk import TickPace

FPS = 30.0


@pytest.fixture
def loop(monkeypatch):
    """Ticks at these times."""
    pace, now = TickPace(), [0.0]
    monkeypatch.setattr(session_desk.time, "perf_counter", lambda: now[0])

    def tick(*times_s):
        for now[0] in times_s:
            pace.tick()
        return pace

    return tick


def test_a_steady_loop_is_never_late(loop):
    rate, late = loop(*(100.0 + n / FPS for n in range(300))).count(100.0, 100.0, FPS)
    assert rate == pytest.approx(FPS) and late == 0


def test_gaps_count_until_the_loop_begins_anew(loop):
    pace = loop(*(100.0 + n / FPS for n in range(10)), 100.8, 101.2)
    assert pace.count(100.0, 100.0, FPS)[1] == 2
    loop(101.3)
    assert pace.count(100.0, 100.0, FPS)[1] == 3
    loop(103.0)  # of a loop that has begun at 102.9: the pause before it was no tick
    assert pace.count(102.9, 102.9, FPS) == (None, 0)


def test_the_rate_is_of_the_last_seconds(loop):
    slow = [100.0 + n / 10.0 for n in range(100)]
    fast = [slow[-1] + n / FPS for n in range(1, 300)]
    assert loop(*slow).count(100.0, 100.0, FPS)[0] == pytest.approx(10.0)
    assert loop(*fast).count(100.0, 100.0, FPS)[0] == pytest.approx(FPS, rel=0.01)


def test_a_loop_that_nobody_counts_fills_no_memory(loop):
    pace = loop(*(n / FPS for n in range(100_000)))
    assert len(pace._new) < 10_000
    assert pace.count(0.0, 0.0, FPS)[0] == pytest.approx(FPS)
