"""The offset between two clocks, by echoes of which some were held up."""

import math
import random

import pytest

from lerobot_robot_yam.remote.link import ClockOffset
from lerobot_robot_yam.remote.link_messages import Echo

AHEAD_S = 1234.5


def exchange(clock, sent_s, there_s, back_s, thinks_s=0.001, ahead_s=AHEAD_S):
    """An echo whose ways take these times."""
    received_s = sent_s + there_s + ahead_s
    clock.add(Echo(sent_s, received_s, received_s + thinks_s, True), sent_s + there_s + thinks_s + back_s)


def test_equal_ways_give_the_offset_itself():
    clock = ClockOffset()
    exchange(clock, 10.0, 0.02, 0.02)
    assert clock.offset_s == pytest.approx(AHEAD_S, abs=1e-9) and clock.error_s == pytest.approx(0.02)


def test_the_quickest_echo_counts_and_the_error_bounds_what_is_wrong():
    clock, draw = ClockOffset(), random.Random(1)
    for number in range(40):
        exchange(clock, float(number), 0.001 + draw.expovariate(100), 0.001 + draw.expovariate(50))
        assert abs(clock.offset_s - AHEAD_S) <= clock.error_s
    assert clock.error_s < 0.005


def test_old_echoes_are_forgotten():
    clock = ClockOffset()
    exchange(clock, 0.0, 0.0001, 0.0001)
    for number in range(60):
        exchange(clock, 1.0 + number, 0.05, 0.05)
    assert clock.error_s == pytest.approx(0.05)


@pytest.mark.parametrize("slept_s", [40.0, -40.0, 0.05])
def test_what_was_known_before_a_computer_slept_counts_no_longer(slept_s):
    """The workstation (its clock has stood still, so the host's is ahead by more), or the host."""
    clock = ClockOffset()
    for number in range(20):
        exchange(clock, 0.1 * number, 0.0001, 0.0001)
    exchange(clock, 3.0, 0.01, 0.01, ahead_s=AHEAD_S + slept_s)
    assert clock.offset_s == pytest.approx(AHEAD_S + slept_s, abs=1e-9) and not clock.known


def test_clocks_that_drift_are_no_contradiction():
    """By 100 ppm, over the quickest of links: what is known is never thrown away."""
    clock = ClockOffset()
    for number in range(200):
        sent_s = 0.1 * number
        exchange(clock, sent_s, 0.00003, 0.00003, ahead_s=AHEAD_S + 100e-6 * sent_s)
        assert clock.known is (number >= 4)


def test_what_cannot_be_does_not_count():
    clock = ClockOffset()
    clock.add(Echo(5.0, 1.0, 2.0, True), 5.5)  # the host thought for longer than the echo took
    clock.add(Echo(5.0, 2.0, 1.0, True), 9.0)
    assert math.isnan(clock.offset_s)
    exchange(clock, 0.0, 0.1, 0.1)
    clock.clear()
    assert math.isnan(clock.offset_s)
