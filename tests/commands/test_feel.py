"""yam-feel of a pair that a hand moves on the rig, and of data sets."""

import re
import threading
import time

import numpy as np
import pytest

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.commands.feel import main
from lerobot_robot_yam.commands.lib.feel_figures import SPEED_RAD_S, effort
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE
from tests.face.devices.test_pairing import follower, leader
from tests.support.coupled import FOLLOWER, LEADER, POSE
from tests.support.seeded_sets import FPS, write
from tests.support.tiers import spread

IDLE_KD = [0.1, 0.1, 0.1, 0.3, 0.05, 0.05]  # Nm s/rad, of the profile: the damping of a leader that floats
FRICTION_NM = 0.1
LAG_FRAMES = 1


def sweep(seconds, step_s=0.01):
    """Times (k,) and joints (k, 6), 0.5 Hz about POSE."""
    times = np.arange(0.0, seconds, step_s)
    phases = np.arange(6) * 0.7
    return times, POSE + 0.3 * np.sin(np.pi * times[:, None] + phases) * np.clip(times, 0.0, 1.0)[:, None]


def figures(text):
    """The rows of the table, NaN for a dash."""
    rows = re.findall(r"^\S*joint_\d +(.*)$", text, re.MULTILINE)
    return np.array([[float("nan") if word == "–" else float(word) for word in row.split()] for row in rows])


@pytest.mark.long
@pytest.mark.alone
def test_a_coupled_pair_is_measured(tmp_path, capsys):
    picture = tmp_path / "feel.png"
    with running_rig(arms=[LEADER, FOLLOWER]) as rig:
        teleop, robot = leader(rig, tmp_path, follower=FOLLOWER), follower(rig, tmp_path)
        ends = threading.Event()

        def pass_on():
            while not ends.wait(1 / FPS):
                robot.send_action(teleop.get_action())

        thread = threading.Thread(target=pass_on)
        teleop.connect()
        try:
            robot.connect()
            thread.start()
            rig.lift(LEADER, POSE.tolist(), 2.0)
            time.sleep(3.0)
            times, path = sweep(12.0, 0.02)
            rig.hand(LEADER, times.tolist(), path.round(5).tolist())
            time.sleep(1.5)
            options = ["--leader", LEADER, "--follower", FOLLOWER, "--rig", rig.name, "--seconds", "8"]
            assert main([*options, "--plot", str(picture)]) == 0
        finally:
            ends.set()
            if thread.is_alive():
                thread.join()
            robot.disconnect()
            teleop.disconnect()
    said = capsys.readouterr().out
    moved, lag_ms, error_mrad, jerk, feedback, largest, backdrive = figures(said).T
    assert len(moved) == 6 and (moved > 0.4).all()
    assert (lag_ms > 0.0).all() and lag_ms.max() < 20.0 and error_mrad.max() < 8.0 and jerk.max() < 5.0, said
    assert (feedback <= largest).all() and feedback.max() < 0.3, said  # there is none
    np.testing.assert_allclose(backdrive, FRICTION_NM + 0.5 * np.array(IDLE_KD), atol=0.06, err_msg=said)
    assert f"{FOLLOWER}: follows at loop rate for 100% of the time" in said
    assert said.count("periods of the loop p50 4.") == 2 and picture.stat().st_size > 10_000


def test_drag_and_feedback_are_told_apart():
    arm, gripper = resolve_profiles("yam", "yam_teaching_handle")
    times, q = sweep(10.0, 0.02)
    dq = np.gradient(q, times, axis=0)
    pull = np.where((times > 6.0) & (times < 6.5), 1.0, 0.0)[:, None]
    states = np.zeros(len(times), STATE_DTYPE)
    states["mode"], states["joints"] = Mode.FLOAT, 6
    states["q"][:, :6], states["dq"][:, :6] = q, dq
    weight = np.array([GravityModel(arm, gripper).torque(row) for row in q])
    states["tau"][:, :6] = 1.1 * weight - 0.2 * np.sign(dq) - 0.3 * dq + pull
    found = effort(states, arm, gripper)
    np.testing.assert_allclose(found.drag_nm, 0.2 + 0.3 * SPEED_RAD_S, atol=0.1)
    during = pull[:, 0] > 0.0
    assert np.abs(found.feedback_nm[during].mean(axis=0) - 1.0).max() < 0.3
    assert np.abs(found.feedback_nm[~during].mean(axis=0)).max() < 0.1
    states["tau"] = 0.0  # a leader without motors
    assert np.isnan(effort(states, arm, gripper).backdrive_nm).all()


@pytest.mark.parametrize("unit", spread(["radians", "degrees"], 1))
def test_a_recording_tells_lag_and_error(tmp_path, capsys, unit):
    _, path = sweep(10.0, 1 / FPS)
    path[:, 4] = 0.1  # this joint stands still
    state = np.roll(path, LAG_FRAMES, axis=0)
    state[:LAG_FRAMES] = path[0]
    state += np.random.default_rng(0).normal(0.0, 0.002, state.shape)
    names = [f"joint_{n}.pos" for n in range(1, 7)]
    factor, robot = (1.0, "yam_follower") if unit == "radians" else (180.0 / np.pi, "yam_follower_degrees")
    write(
        tmp_path / "data", [((path * factor).astype(np.float32), (state * factor).astype(np.float32))], (), robot, names
    )
    assert main([str(tmp_path / "data"), "--plot", str(tmp_path / "feel.svg")]) == 0
    moved, lag_ms, error_mrad, _ = figures(capsys.readouterr().out).T
    moves = np.arange(6) != 4
    np.testing.assert_allclose(lag_ms[moves], 1e3 * LAG_FRAMES / FPS, atol=2.0)
    assert np.isnan(lag_ms[4]) and moved[4] == 0.0
    np.testing.assert_allclose(error_mrad, 2.0, atol=0.5)
    assert (tmp_path / "feel.svg").exists()


def test_what_cannot_be_measured_is_said(tmp_path, capsys):
    still = np.zeros((50, 2), np.float32)
    write(tmp_path / "poses", [(still, still)], (), value_names=["ee_x.pos", "ee_y.pos"])
    write(tmp_path / "short", [(still[:9], still[:9])], (), value_names=["joint_1.pos", "joint_2.pos"])
    for arguments, says in [
        (["--leader", "can0", "--follower", "can1"], "can0: no session drives it"),
        (["--leader", "can0", "--follower", "can1", "--arm", "yom"], "yom"),
        ([str(tmp_path / "poses")], "its actions are no joints"),
        ([str(tmp_path)], "info.json cannot be read"),
        ([str(tmp_path / "short")], "episode 0 has 9 frames; give --episode another number"),
        ([str(tmp_path / "short"), "--episode", "7"], "episode 7 has no rows that can be read; there are 1"),
    ]:
        assert main(arguments) == 1
        assert says in capsys.readouterr().err
    for arguments in ([], ["--leader", "can0"], [str(tmp_path), "--leader", "a", "--follower", "b"]):
        with pytest.raises(SystemExit):
            main(arguments)
