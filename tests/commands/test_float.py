"""yam-float at a terminal, on the rig: a scripted hand moves the arm, which does the same again by itself."""

import argparse
import contextlib
import dataclasses
import json
import signal
import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.commands.float import configs_of, main
from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops, save_stops
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.state_recorder import StateRecorder
from lerobot_robot_yam.session.trajectory_file import load_trajectory
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from scripts import recorders
from tests.support.crooked_arm import STOPS, arguments, scene
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.rigged import STOPS as RIG_STOPS
from tests.support.rigged import track
from tests.support.terminal import Terminal
from tests.support.waiting import wait

RAISED = [0.2, 0.7, 0.7, -0.3, 0.1, 0.2]
WAVED = [0.0, 0.9, 0.8, -0.1, -0.1, -0.1]
MOST_RAD = 0.005
ROW = [0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.5]


@pytest.fixture
def arm(tmp_path):
    """A live rig with one arm at rest."""
    with running_rig(scene=scene(tmp_path, [0.0] * 7)) as rig:
        yield rig


@pytest.fixture
def console(tmp_path):
    """Starts `yam-float` for the arms of a rig in a terminal."""
    save_stops("arm", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))
    with contextlib.ExitStack() as opened:

        def start(*more):
            command = [sys.executable, "-m", "lerobot_robot_yam.commands.float", "--calibration", "stops.json", *more]
            terminal = opened.enter_context(Terminal(tmp_path, *command, cwd=tmp_path))
            terminal.answer(("Type float to go on:", b"float\n"), (": FLOAT", b""))
            return terminal

        yield start


def lift(rig, q, seconds=1.0, **options):
    rig.lift("only", q, seconds, **options)
    rig.wait_event("hand_arrived", 10.0, since=len(rig.events()))


def q_of(rig, channel="only"):
    return np.array(rig.state()["arms"][channel]["q"])[:6]


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
    terminal.answer(("", b"r"), ("RECORDING", b""))
    lift(arm, WAVED)
    lift(arm, RAISED)
    time.sleep(0.3)
    held = q_of(arm)
    terminal.answer(("", b"s"), ("saved to trajectory.npy", b""))
    lift(arm, [0.0, 0.5, 0.5, 0.0, 0.0, 0.0], 0.8, then_release=True)
    recorders.truth_start(arm, "only", 30.0)
    terminal.answer(("", b"l\n"), ("loaded trajectory.npy", b"p"), ("replayed; the arm holds", b""))
    ended_s = time.monotonic()
    time.sleep(1.0)
    np.testing.assert_allclose(q_of(arm), held, atol=MOST_RAD)
    truth, trajectory = recorders.truth(arm, "only"), load_trajectory(tmp_path / "trajectory.npy")
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
    np.save(tmp_path / "far.npy", {"trajectory": np.array([ROW, [9.0, *ROW[1:]]]), "timestamps": np.arange(2.0)})
    terminal = console(*arguments(arm))
    terminal.answer(
        ("", b"ps"),
        ("there is nothing to save; record it first (r)", b"h"),
        ("only (only): HOLD", b"lfar.npx\x7fy\n"),
        ("far.npy: joint_1 is at 9.000 in row 1, and takes -2.62 … 3.14; nothing moves", b"lgone.npy\n"),
        ("gone.npy cannot be read (No such file or directory)", b"d"),
        ("only (only): OFF", b""),
    )
    assert not enabled(arm)
    seen = len(terminal.shown)
    terminal.type(b"f")
    wait(lambda: ": FLOAT" in terminal.shown[seen:], 30.0)
    assert enabled(arm)
    terminal.type(b"q")
    assert terminal.end() == 0 and not enabled(arm)


@pytest.fixture
def replaying(arm, console, tmp_path):
    """`yam-float` in the middle of a replay."""
    np.save(tmp_path / "trajectory.npy", {"trajectory": np.array([ROW, RAISED + [0.5]]), "timestamps": [0.0, 9.0]})
    terminal = console(*arguments(arm))
    terminal.answer(("", b"l\n"), ("loaded trajectory.npy", b"p"), ("REPLAYING", b""))
    return terminal


@pytest.mark.long
def test_a_replay_ends_when_keys_begin_to_spell_a_name(arm, replaying):
    replaying.answer(("", b"lh"), ("file to load (Enter alone: trajectory.npy, Escape: none): h", b""))
    time.sleep(0.5)
    before = q_of(arm)
    time.sleep(1.0)
    np.testing.assert_allclose(q_of(arm), before, atol=0.02)
    replaying.type(b"\x1bq")
    assert replaying.end() == 0 and not enabled(arm)


@pytest.mark.long
def test_an_emergency_stop_ends_a_replay(arm, replaying):
    EmergencyStop().latch("somebody shouted")
    try:
        replaying.wait_shown("only: pose not reached, the arm is in mode stopped")
    finally:
        EmergencyStop().release()
    replaying.wait_shown("only (only): HOLD")
    before = q_of(arm)
    time.sleep(1.0)
    np.testing.assert_allclose(q_of(arm), before, atol=0.05)
    replaying.type(b"q")
    assert replaying.end() == 0


@pytest.mark.long
def test_arms_that_an_emergency_stop_keeps_in_the_air_have_not_landed(arm, console):
    terminal = console(*arguments(arm))
    lift(arm, RAISED, then_release=True)
    EmergencyStop().latch("somebody shouted")
    try:
        terminal.answer(("only (only): STOPPED", b"q"), ("THE ARMS ARE STILL IN THE AIR", b""))
        assert terminal.end() == 1 and "the arms have landed" not in terminal.shown
        assert enabled(arm)
    finally:
        EmergencyStop().release()
    wait(lambda: not enabled(arm))


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_every_end_lands_the_arm_and_gives_the_terminal_back(arm, console, number):
    terminal = console(*arguments(arm))
    lift(arm, RAISED, then_release=True)
    terminal.kill(number)
    assert terminal.end() != 0
    wait(lambda: not enabled(arm))
    assert moved_after_cut_m(arm, "only") < MOST_M
    first, last = terminal.modes()
    assert first == last or number is signal.SIGKILL


@pytest.mark.long
def test_two_arms_are_recorded_and_replayed_together(console, tmp_path):
    channels = ["follower_left", "leader_left"]
    with running_rig() as rig:
        command = ["--channel", *channels, "--rig", rig.name, "--gripper", "linear_4310", "yam_teaching_handle"]
        terminal = console(*command, "--calibration", "stops.json", "handle.json")
        terminal.answer(("", b"r"), ("RECORDING", b""))
        for channel in channels:
            rig.lift(channel, WAVED, 1.0)
        time.sleep(1.8)
        terminal.answer(("", b"s"), ("saved to trajectory.npy", b""))
        trajectory = load_trajectory(tmp_path / "trajectory.npy")
        assert len(trajectory.columns) == 13
        for channel in channels:
            rig.release(channel)
        terminal.answer(("", b"p"), ("replayed; the arm holds", b""))
        time.sleep(1.0)
        for channel, q in zip(channels, (trajectory.positions[-1, :6], trajectory.positions[-1, 7:]), strict=True):
            np.testing.assert_allclose(q_of(rig, channel), q, atol=2 * MOST_RAD)
        terminal.type(b"q")
        assert terminal.end() == 0
        assert not any(enabled(rig, channel) for channel in channels)


ARM_OPTIONS = ("arm", "gripper", "name", "calibration", "tuning", "payload", "tilt", "friction", "config_path")


def named(**options):
    """The arguments of yam-float for an arm of a virtual rig, which need not run."""
    options = {"channel": ["follower_left"], "gripper": ["linear_4310"], "rig": "none", "interface": None} | options
    return argparse.Namespace(**{**dict.fromkeys(ARM_OPTIONS), "arm": ["yam"], **options})


def test_an_arm_of_the_rig_stays_where_it_is_let_go():
    """Which weighs what the model says; the maker's factors are for real arms."""
    with contextlib.closing(LockstepRig(arms=["follower_left"])) as rig:
        place = {"interface": "yam_lockstep", "can_options": {"rig": rig.name}}
        (config,) = configs_of(named(calibration=None))
        session = ArmSession([dataclasses.replace(config, gripper_stops_rad=RIG_STOPS, **place)], isolation="lockstep")
        session.start()
        with pytest.raises(ActionError, match="recording is too short"):  # two quick r
            StateRecorder([session["follower_left"]]).trajectory()
        track(session, {"follower_left": RAISED}, 2.0)
        session["follower_left"].float()
        session.clock.sleep(0.3)
        before = session["follower_left"].observe().q
        session.clock.sleep(2.0)
        after = session["follower_left"].observe().q
        session.discard()
    assert np.abs(after - before).max() < 0.01


def test_what_an_arm_carries_and_a_config_reach_the_arm(tmp_path):
    (config,) = configs_of(named(payload=0.4, tilt=[0.1, 0.2], friction=[0.1] * 6))
    assert (config.payload_mass_kg, config.base_tilt_rad, config.track_integral) == (0.4, [0.1, 0.2], True)
    assert config.coulomb_friction_nm == [0.1] * 6
    (config,) = configs_of(named(tuning=["left.yaml"]))
    assert config.tuning == "left.yaml" and config.gravity_factor is None
    path = tmp_path / "rig.yaml"
    arm = {"channel": "can_a", "gripper": "linear_4310", "payload_mass_kg": 0.3}
    path.write_text(json.dumps({"robot": {"type": "yam_follower", **arm}}))
    (config,) = configs_of(named(channel=None, config_path=path, rig=None))
    assert (config.channel, config.payload_mass_kg, config.track_integral) == ("can_a", 0.3, True)
    with pytest.raises(ConfigError, match="set payload_mass_kg in .*rig.yaml"):
        configs_of(named(channel=None, config_path=path, rig=None, payload=0.1))
    for both in ({"channel": None}, {"config_path": path}):
        with pytest.raises(ConfigError, match="Give --channel, or --config_path; one of them"):
            configs_of(named(**both))


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
