"""Search and verification of the stops against a small model of a gripper: a motor between two walls."""

import json
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.arm.force_limiter import ForceLimiter
from lerobot_robot_yam.arm.gripper import GripperStops, find_stops, load_stops, save_stops, verify_stops
from lerobot_robot_yam.arm.joints import TURN
from lerobot_robot_yam.arm.profile import load_gripper
from lerobot_robot_yam.errors import GripperError

GOLDEN = Path(__file__).parents[1] / "golden"
GRIPPER = load_gripper("linear_4310")
CALIBRATION = GRIPPER.calibration
CLOSED, OPEN = 3.25, -3.3


class Fingers:
    """First-order motor with friction between walls; `blocked` is an object at that angle."""

    def __init__(self, start, blocked=None, closed=CLOSED, opened=OPEN):
        self.position, self.low, self.high = start, opened, closed if blocked is None else blocked
        self.largest_torque = 0.0
        self.travel = 0.0

    def drive(self, search):
        """Run a search to its end; returns what it found."""
        speed, kd = next(search)
        now = 0.0
        rate = 0.0
        while True:
            torque = kd * (speed - rate)
            rate = 0.0 if abs(torque) < 0.1 else speed * 0.8
            step = np.clip(self.position + rate * 0.004, self.low, self.high) - self.position
            rate = step / 0.004
            self.largest_torque = max(self.largest_torque, abs(kd * (speed - rate)))
            self.position += step
            self.travel += abs(step)
            now += 0.004
            try:
                speed, kd = search.send((now, self.position))
            except StopIteration as found:
                return found.value


@pytest.mark.parametrize("start", [CLOSED, OPEN, 0.4])
def test_both_stops_are_found_without_exceeding_the_calibration_torque(start):
    fingers = Fingers(start)
    stops = fingers.drive(find_stops("left", CALIBRATION))
    assert stops.closed_rad == pytest.approx(CLOSED, abs=0.02)
    assert stops.open_rad == pytest.approx(OPEN, abs=0.02)
    assert fingers.largest_torque <= CALIBRATION.torque_nm + 1e-9


def test_an_object_is_not_a_stop():
    with pytest.raises(GripperError, match="left: gripper stops .* take any object out"):
        Fingers(-1.0, blocked=0.0).drive(find_stops("left", CALIBRATION))


@pytest.mark.parametrize("turns", [-1, 0, 1])
@pytest.mark.parametrize("start", [CLOSED, OPEN, CLOSED - 0.2, OPEN + 0.2, 0.4])
def test_stored_stops_resolve_the_turn_after_a_power_cycle(start, turns):
    """The motor counts anew: its reading is off by whole turns, the stored stops are not."""
    off = turns * TURN
    fingers = Fingers(start + off, closed=CLOSED + off, opened=OPEN + off)
    stops = fingers.drive(verify_stops("left", CALIBRATION, GripperStops(CLOSED, OPEN)))
    assert stops.shift_rad == pytest.approx(-off)
    assert fingers.travel < 0.7
    assert fingers.largest_torque <= CALIBRATION.torque_nm + 1e-9


def test_a_blocked_jaw_near_the_closed_stop_is_not_taken_for_the_open_stop():
    fingers = Fingers(CLOSED - 0.1)
    fingers.low = CLOSED - 0.15  # something wedges the fingers: they cannot open
    with pytest.raises(GripperError, match="free its fingers"):
        fingers.drive(verify_stops("left", CALIBRATION, GripperStops(CLOSED, OPEN)))


def test_inverted_and_tiny_spans_are_refused():
    with pytest.raises(GripperError, match="inverted"):
        next(verify_stops("left", CALIBRATION, GripperStops(OPEN, CLOSED)))
    with pytest.raises(GripperError, match="span 0.083"):
        next(verify_stops("left", CALIBRATION, GripperStops(0.083, 0.0)))


def test_stops_survive_on_disk_and_foreign_files_are_refused(tmp_path):
    path = tmp_path / "yam" / "left.json"
    assert load_stops(path, "linear_4310") is None
    save_stops(path, "linear_4310", GripperStops(CLOSED, OPEN))
    assert load_stops(path, "linear_4310") == GripperStops(CLOSED, OPEN)
    with pytest.raises(GripperError, match="crank_4310"):
        load_stops(path, "crank_4310")
    path.write_text("{}")
    with pytest.raises(GripperError, match="not a gripper calibration"):
        load_stops(path, "linear_4310")


@pytest.mark.parametrize("name", ["linear_4310", "linear_3507", "crank_4310"])
def test_force_limiter_reproduces_the_golden_traces(name):
    trace = json.loads((GOLDEN / "gripper_limiter.json").read_text())["traces"][name]
    limiter = ForceLimiter(
        load_gripper(name).limiter, trace["kp"], tuple(trace["limits_closed_open"]), trace["max_force_newton"]
    )
    clogged = 0
    for t, target, position, rate, effort, _, output, clipped, expected in trace["rows"]:
        assert limiter.limit(t, target, position, rate, effort) == pytest.approx(output, abs=1e-12)
        assert limiter.clogged == expected
        limiter.sent(clipped)
        clogged += expected
    assert clogged > 50
