"""yam-float at a terminal, on the rig: a scripted hand moves the arm, which does the same again by itself."""

import signal
import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.commands.float import main
from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops, save_stops
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.trajectory_file import load_trajectory
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from tests.support.crooked_arm import STOPS, arguments
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.terminal import Terminal

RAISED = [0.2, 0.7, 0.7, -0.3, 0.1, 0.2]
WAVED = [0.0, 0.9, 0.8, -0.1, -0.1, -0.1]
MOST_RAD = 0.005
ROW = [0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.5]


@pytest.fixture
def console(tmp_path):
    """Starts `yam-float` for the arms of a rig in a terminal."""
    opened = []
    save_stops("arm", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))

    def start(*more):
        command = [sys.executable, "-m", "lerobot_robot_yam.commands.float", "--calibration", "stops.json", *more]
        opened.append(Terminal(tmp_path, *command, cwd=tmp_path))
        terminal = opened[0]
        terminal.wait_shown("Type float to go on:")
        terminal.type(b"float\n")
        terminal.wait_shown(": FLOAT")
        return terminal

    yield start
    for terminal in opened:
        terminal.close()


def lift(rig, q, seconds=1.0, **options):
    rig.lift("only", q, seconds, **options)
    rig.wait_event("hand_arrived", 10.0, since=len(rig.events()))


def enabled(rig, channel="only"):
    return [name for name, motor in rig.state()["arms"][channel]["motors"].items() if motor["enabled"]]


def replayed_error(truth, trajectory, ended_s, lag_s):
    """How far the joints were (k, 6) from a trajectory that was over at `ended_s`, and followed `lag_s` later."""
    times = ended_s - trajectory.seconds + trajectory.times_s + lag_s
    there = [np.interp(times, truth["stamp_s"], truth["q"][:, joint]) for joint in range(6)]
    return np.abs(np.array(there).T - trajectory.positions[:, :6])


@pytest.mark.long
def test_what_a_hand_does_is_recorded_saved_loaded_and_replayed(arm, console, tmp_path):
    terminal = console(*arguments(arm))
    lift(arm, RAISED)
    terminal.type(b"r")
    terminal.wait_shown("RECORDING")
    lift(arm, WAVED)
    lift(arm, RAISED)
    time.sleep(0.3)
    held = np.array(arm.state()["arms"]["only"]["q"])[:6]
    terminal.type(b"s")
    terminal.wait_shown("saved to trajectory.npy")
    lift(arm, [0.0, 0.5, 0.5, 0.0, 0.0, 0.0], 0.8, then_release=True)
    arm.truth_start("only", 30.0)
    terminal.type(b"l\n")
    terminal.wait_shown("loaded trajectory.npy")
    terminal.type(b"p")
    terminal.wait_shown("replayed; the arm holds")
    ended_s = time.monotonic()
    time.sleep(1.0)
    np.testing.assert_allclose(arm.state()["arms"]["only"]["q"][:6], held, atol=MOST_RAD)
    truth, trajectory = arm.truth("only"), load_trajectory(tmp_path / "trajectory.npy")
    errors = [replayed_error(truth, trajectory, ended_s, lag_s) for lag_s in np.arange(-0.4, 0.1, 0.004)]
    nearest = min(errors, key=lambda error: np.square(error).sum())
    assert np.sqrt(np.square(nearest).mean(axis=0)).max() < MOST_RAD  # test_playback has the largest
    terminal.type(b"q")
    assert terminal.end() == 0
    first, last = terminal.modes()
    assert first == last
    assert not enabled(arm) and moved_after_cut_m(arm, "only") < MOST_M


@pytest.mark.long
def test_keys_hold_land_bring_up_again_and_say_what_cannot_be(arm, console, tmp_path):
    terminal = console(*arguments(arm))
    terminal.type(b"ps")
    terminal.wait_shown("there is nothing to save; record it first (r)")
    terminal.type(b"h")
    terminal.wait_shown("only (only): HOLD")
    np.save(tmp_path / "far.npy", {"trajectory": np.array([ROW, [9.0, *ROW[1:]]]), "timestamps": np.arange(2.0)})
    terminal.type(b"lfar.npx\x7fy\n")
    terminal.wait_shown("far.npy: joint_1 is at 9.000 in row 1, and takes -2.62 … 3.14; nothing moves")
    terminal.type(b"lgone.npy\n")
    terminal.wait_shown("gone.npy cannot be read (No such file or directory)")
    terminal.type(b"d")
    terminal.wait_shown("only (only): OFF")
    assert not enabled(arm)
    seen = len(terminal.shown)
    terminal.type(b"f")
    while ": FLOAT" not in terminal.shown[seen:]:
        time.sleep(0.05)
    assert enabled(arm)
    terminal.type(b"q")
    assert terminal.end() == 0 and not enabled(arm)


@pytest.mark.long
def test_a_replay_ends_when_keys_begin_to_spell_a_name(arm, console, tmp_path):
    np.save(tmp_path / "trajectory.npy", {"trajectory": np.array([ROW, RAISED + [0.5]]), "timestamps": [0.0, 9.0]})
    terminal = console(*arguments(arm))
    terminal.type(b"l\n")
    terminal.wait_shown("loaded trajectory.npy")
    terminal.type(b"p")
    terminal.wait_shown("REPLAYING")
    terminal.type(b"lh")
    terminal.wait_shown("file to load (Enter alone: trajectory.npy, Escape: none): h")
    time.sleep(0.5)
    before = np.array(arm.state()["arms"]["only"]["q"])
    time.sleep(1.0)
    np.testing.assert_allclose(arm.state()["arms"]["only"]["q"], before, atol=0.02)
    terminal.type(b"\x1bq")
    assert terminal.end() == 0 and not enabled(arm)


@pytest.mark.long
def test_arms_that_an_emergency_stop_keeps_in_the_air_have_not_landed(arm, console):
    terminal = console(*arguments(arm))
    lift(arm, RAISED, then_release=True)
    EmergencyStop().latch("somebody shouted")
    try:
        terminal.wait_shown("only (only): STOPPED")
        terminal.type(b"q")
        terminal.wait_shown("THE ARMS ARE STILL IN THE AIR")
        assert terminal.end() == 1 and "the arms have landed" not in terminal.shown
        assert enabled(arm)
    finally:
        EmergencyStop().release()
    while enabled(arm):
        time.sleep(0.05)


@pytest.mark.long
def test_an_emergency_stop_ends_a_replay(arm, console, tmp_path):
    np.save(tmp_path / "trajectory.npy", {"trajectory": np.array([ROW, RAISED + [0.5]]), "timestamps": [0.0, 9.0]})
    terminal = console(*arguments(arm))
    terminal.type(b"l\n")
    terminal.wait_shown("loaded trajectory.npy")
    terminal.type(b"p")
    terminal.wait_shown("REPLAYING")
    EmergencyStop().latch("somebody shouted")
    try:
        terminal.wait_shown("only: pose not reached, the arm is in mode stopped")
    finally:
        EmergencyStop().release()
    terminal.wait_shown("only (only): HOLD")
    before = np.array(arm.state()["arms"]["only"]["q"])
    time.sleep(1.0)
    np.testing.assert_allclose(arm.state()["arms"]["only"]["q"], before, atol=0.05)
    terminal.type(b"q")
    assert terminal.end() == 0


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_every_end_lands_the_arm_and_gives_the_terminal_back(arm, console, number):
    terminal = console(*arguments(arm))
    lift(arm, RAISED, then_release=True)
    terminal.kill(number)
    assert terminal.end() != 0
    deadline = time.monotonic() + 15.0
    while enabled(arm) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not enabled(arm) and moved_after_cut_m(arm, "only") < MOST_M
    first, last = terminal.modes()
    assert first == last or number is signal.SIGKILL


@pytest.mark.long
def test_two_arms_are_recorded_and_replayed_together(console, tmp_path):
    channels = ["follower_left", "leader_left"]
    with running_rig() as rig:
        command = ["--channel", *channels, "--rig", rig.name, "--gripper", "linear_4310", "yam_teaching_handle"]
        terminal = console(*command, "--calibration", "stops.json", "handle.json")
        terminal.type(b"r")
        terminal.wait_shown("RECORDING")
        for channel in channels:
            rig.lift(channel, WAVED, 1.0)
        time.sleep(1.8)
        terminal.type(b"s")
        terminal.wait_shown("saved to trajectory.npy")
        trajectory = load_trajectory(tmp_path / "trajectory.npy")
        assert len(trajectory.columns) == 13
        for channel in channels:
            rig.release(channel)
        ends = trajectory.positions[-1, :6], trajectory.positions[-1, 7:]
        terminal.type(b"p")
        terminal.wait_shown("replayed; the arm holds")
        time.sleep(1.0)
        for channel, q in zip(channels, ends, strict=True):
            np.testing.assert_allclose(rig.state()["arms"][channel]["q"][:6], q, atol=2 * MOST_RAD)
        terminal.type(b"q")
        assert terminal.end() == 0
        assert not any(enabled(rig, channel) for channel in channels)


def refused(capsys, *more):
    assert main(["--channel", "nobody", "--rig", "none", "--gripper", "linear_4310", *map(str, more)]) == 1
    return capsys.readouterr().err


def test_without_a_terminal_nothing_is_energised(capsys):
    assert "there is no terminal to type them; nothing was energised" in refused(capsys)


def test_a_file_or_a_number_of_arms_that_does_not_fit_is_refused_before_anything_is_energised(
    capsys, monkeypatch, tmp_path
):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    path = tmp_path / "other.npy"
    assert "other.npy cannot be read" in refused(capsys, "--load", path)
    np.save(path, {"trajectory": np.array([ROW[:6], ROW[:6]]), "timestamps": np.arange(2.0)})
    assert "other.npy is of other joints: it has 6 columns, and nobody has 7 (joint_1" in refused(
        capsys, "--load", path
    )
    assert main(["--channel", "a", "b", "c", "--rig", "none"]) == 1
    assert "--channel takes one or two channels, not 3" in capsys.readouterr().err
    assert main(["--channel", "a", "b", "--rig", "none", "--calibration", "a", "b", "c"]) == 1
    assert "--calibration takes one value for each of a, b, not 3" in capsys.readouterr().err
