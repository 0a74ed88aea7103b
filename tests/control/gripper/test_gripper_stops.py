"""Search and verification of the stops against a small model of a gripper: a motor between two walls."""

import json
import os
import time

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.joint_map import TURN
from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.control.gripper.force_limiter import ForceLimiter
from lerobot_robot_yam.control.gripper.gripper import Gripper
from lerobot_robot_yam.control.gripper.gripper_stops import (
    GripperStops,
    find_stops,
    load_stops,
    save_stops,
    verify_stops,
)
from lerobot_robot_yam.errors import GripperError
from tests.support.paths import GOLDEN

GRIPPER = load_gripper("linear_4310")
CALIBRATION = GRIPPER.calibration
CLOSED, OPEN = 3.25, -3.3


class Fingers:
    """First-order motor with friction between walls; `blocked` is an object at that angle."""

    def __init__(self, start, blocked=None, closed=CLOSED, opened=OPEN, sense=1.0):
        self.sense = sense  # −1: it turns the other way round than it is told
        self.position, self.low, self.high = start, opened, closed if blocked is None else blocked
        self.largest_torque = 0.0
        self.travel = 0.0

    def drive(self, search):
        """Run a search to its end; returns what it found."""
        return self.answer(*next(search), search.send)

    def answer(self, speed, kd, send):
        """The same with any function that takes (now, position) and gives (speed, kd)."""
        now = 0.0
        rate = 0.0
        while True:
            torque = kd * (speed - rate)
            rate = 0.0 if abs(torque) < 0.1 else speed * 0.8
            step = np.clip(self.position + self.sense * rate * 0.004, self.low, self.high) - self.position
            rate = self.sense * step / 0.004
            self.largest_torque = max(self.largest_torque, abs(kd * (speed - rate)))
            self.position += step
            self.travel += abs(step)
            now += 0.004
            try:
                speed, kd = send((now, self.position))
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


@pytest.mark.parametrize("start", [0.4, CLOSED - 0.2])
@pytest.mark.parametrize("search", ["find", "verify"])
def test_a_motor_that_turns_the_wrong_way_is_named(search, start):
    if search == "verify":
        start = CLOSED - 0.24  # two turns fit: it is told to open
        steps = verify_stops("left", CALIBRATION, GripperStops(CLOSED, OPEN))
    else:
        steps = find_stops("left", CALIBRATION)
    told = "open" if search == "verify" else "close"
    fingers = Fingers(start, sense=-1.0)
    with pytest.raises(GripperError, match=f"left: told to {told}, the gripper moves the other way .* inverted"):
        fingers.drive(steps)
    assert fingers.travel < 0.2


def test_a_finger_that_never_moves_is_named():
    jammed = Fingers(CLOSED - 0.1)
    jammed.low = jammed.high = CLOSED - 0.1
    for search in (find_stops("left", CALIBRATION), verify_stops("left", CALIBRATION, GripperStops(CLOSED, OPEN))):
        with pytest.raises(GripperError, match="left: the gripper does not move from 3.150 rad"):
            jammed.drive(search)


def test_inverted_and_tiny_spans_are_refused():
    with pytest.raises(GripperError, match="inverted"):
        next(verify_stops("left", CALIBRATION, GripperStops(OPEN, CLOSED)))
    with pytest.raises(GripperError, match="span 0.083"):
        next(verify_stops("left", CALIBRATION, GripperStops(0.083, 0.0)))


def test_stops_survive_on_disk_and_foreign_files_are_refused(tmp_path):
    path = tmp_path / "yam" / "left.json"
    assert load_stops("left", path, "linear_4310") is None
    save_stops("left", path, "linear_4310", GripperStops(CLOSED, OPEN))
    assert load_stops("left", path, "linear_4310") == GripperStops(CLOSED, OPEN)
    with pytest.raises(GripperError, match="crank_4310"):
        load_stops("left", path, "crank_4310")
    for damaged in ("{}", path.read_text().replace("3.25", f"1{'0' * 400}")):  # JSON knows no largest integer
        path.write_text(damaged)
        with pytest.raises(GripperError, match="not a gripper calibration"):
            load_stops("left", path, "linear_4310")


def gripper_axis(path, configured=None):
    config = ArmConfig(name="left", channel="x", calibration_path=str(path), gripper_stops_rad=configured)
    return Gripper(config, GRIPPER, GRIPPER.motor.kp, GRIPPER.motor.kd)


def wait_for(condition):
    """What was found is stored beside the loop."""
    deadline = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def bring_up(axis, fingers, calibrate=False):
    """As the control loop does it; returns the shift."""
    axis.begin(calibrate)

    def send(at):
        shift = axis.advance(*at)
        if shift is not None:
            found = StopIteration()
            found.value = shift
            raise found
        row = np.zeros(5)
        axis.command(row, at[0], 0.0, 0.0, at[1], 0.0, 0.0)
        return row[1], row[3]

    return fingers.answer(0.0, 0.1, send)


def test_only_a_search_writes_the_stops(tmp_path, caplog):
    """Verified or configured stops leave the file alone; a search without any is said."""
    path = tmp_path / "left.json"
    bring_up(gripper_axis(path), Fingers(0.4))
    assert "no gripper stops are known" in caplog.text
    wait_for(path.exists)
    assert load_stops("left", path, "linear_4310").closed_rad == pytest.approx(CLOSED, abs=0.02)
    save_stops("left", path, "linear_4310", GripperStops(CLOSED + 0.03, OPEN + 0.03))
    stored = path.read_text()
    inode = path.stat().st_ino
    for configured in (None, [CLOSED - 0.02, OPEN - 0.02]):
        axis = gripper_axis(path, configured)
        bring_up(axis, Fingers(0.4))
        assert axis.stops.closed_rad == (CLOSED + 0.03 if configured is None else CLOSED - 0.02)
        assert path.read_text() == stored and path.stat().st_ino == inode
    bring_up(gripper_axis(path), Fingers(0.4), calibrate=True)
    wait_for(lambda: path.stat().st_ino != inode)
    assert path.read_text() != stored


def test_beginning_again_verifies_what_this_session_knows_and_searches_nothing():
    """After a re-arm something may be in the hand; without a file or configuration it would be taken for a stop."""
    config = ArmConfig(name="left", channel="x")
    axis = Gripper(config, GRIPPER, GRIPPER.motor.kp, GRIPPER.motor.kd)
    bring_up(axis, Fingers(0.4))
    found = axis.stops
    gripping = Fingers(0.4, blocked=0.5)
    bring_up(axis, gripping)
    assert axis.stops == found and gripping.travel == 0.0
    with pytest.raises(GripperError):
        bring_up(axis, Fingers(0.4, blocked=0.5), calibrate=True)
    bring_up(axis, gripping)
    assert axis.stops == found


def test_a_search_that_fails_leaves_the_stored_stops(tmp_path):
    path = tmp_path / "left.json"
    save_stops("left", path, "linear_4310", GripperStops(CLOSED, OPEN))
    axis = gripper_axis(path)
    with pytest.raises(GripperError, match="take any object out"):
        bring_up(axis, Fingers(-1.0, blocked=0.0), calibrate=True)
    assert axis.stops is None
    assert load_stops("left", path, "linear_4310") == GripperStops(CLOSED, OPEN)


def test_an_explicit_calibration_replaces_a_damaged_file_and_nothing_else_does(tmp_path):
    path = tmp_path / "left.json"
    path.write_text("{}")
    with pytest.raises(GripperError, match="not a gripper calibration"):
        gripper_axis(path).begin()
    assert path.read_text() == "{}"
    bring_up(gripper_axis(path), Fingers(0.4), calibrate=True)
    wait_for(lambda: path.read_text() != "{}")
    assert load_stops("left", path, "linear_4310").open_rad == pytest.approx(OPEN, abs=0.02)


def test_stops_that_cannot_be_stored_count_all_the_same(tmp_path, caplog):
    """A full disk, a home that is read-only: only the next start has to search again."""
    path = tmp_path / "no directory" / "left.json"
    (tmp_path / "no directory").touch()
    axis = gripper_axis(path)
    bring_up(axis, Fingers(0.4), calibrate=True)
    assert axis.stops.closed_rad == pytest.approx(CLOSED, abs=0.02)
    wait_for(lambda: "cannot be stored" in caplog.text)
    assert f"left: the gripper's stops cannot be stored in {path}" in caplog.text and "File exists" in caplog.text


def test_a_disk_that_hangs_does_not_hold_the_loop_up(tmp_path):
    path = tmp_path / "left.json"
    hangs = path.with_name(f"{path.name}.{os.getpid()}")
    os.mkfifo(hangs)
    axis = gripper_axis(path)
    bring_up(axis, Fingers(0.4), calibrate=True)
    assert axis.stops is not None and not path.exists()
    assert json.loads(hangs.read_text())["gripper"] == "linear_4310"


def test_a_calibration_that_cannot_be_read_is_refused_by_name(tmp_path):
    with pytest.raises(GripperError, match=f"left: the gripper calibration {tmp_path} cannot be read.*directory"):
        gripper_axis(tmp_path).begin()


def test_a_file_that_cannot_be_replaced_leaves_nothing_half_written(tmp_path):
    (tmp_path / "left.json").mkdir()
    with pytest.raises(GripperError, match="cannot be stored"):
        save_stops("left", tmp_path / "left.json", "linear_4310", GripperStops(CLOSED, OPEN))
    assert [path.name for path in tmp_path.iterdir()] == ["left.json"]


def test_calibrating_against_configured_stops_says_that_these_will_count_again(tmp_path, caplog):
    bring_up(gripper_axis(tmp_path / "left.json", [CLOSED, OPEN]), Fingers(0.4), calibrate=True)
    assert "`gripper_stops_rad` is configured" in caplog.text


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
