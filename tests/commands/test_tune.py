"""yam-tune of arms of the rig that weigh and rub otherwise than their profiles say."""

import argparse
import contextlib
import io
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.tuning import load_tuning, save_tuning
from lerobot_robot_yam.commands.lib.tune.tune_motion import MARGIN_M, torque_steps
from lerobot_robot_yam.commands.tune import LEGS, Tuner, main, tune
from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops, save_stops
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.system.own_commands import install_extra
from tests.support.deviating import CHANNEL, STOPS, VISCOUS_NM_S, deviation, scene, true_gravity
from tests.support.rigged import sim_config
from tests.support.terminal import Terminal

SAFE = WorkspaceConfig(floor_z_m=MARGIN_M, collision_margin_m=MARGIN_M)
SHARE, STEPS = 0.03, 2.0  # of the torque, and steps of its feedback
HOLD_RAD = 0.003
RUB_NM = 0.1  # of every joint, in the profile
SETTLE_S = 5.0  # of the integral
MOST_S = 180.0
POSES = 200
HIGH, LOW = [0.0, 1.2, 1.2, -0.5, 0.0, 0.0], [0.0, 1.85, 1.2, -1.2, 0.0, 0.0]  # 20 mm above the table


@pytest.fixture
def made(tmp_path):
    """Makes a rig with one arm that deviates so, and returns it with the arm's true weight."""
    with contextlib.ExitStack() as stack:

        def make(row):
            path = scene(tmp_path, row)
            return stack.enter_context(contextlib.closing(LockstepRig(path))), row and true_gravity(path)

        yield make


def options(tmp_path, **fields):
    plain = {"out": tmp_path / "left.yaml", "force": False, "guided": False, "payload": None, "floor_z": None}
    return argparse.Namespace(**(plain | {"plot": None} | fields))


@pytest.fixture
def live(tmp_path):
    """A rig that runs, with one arm that is as its profile says."""
    with running_rig(scene=scene(tmp_path, None)) as rig:
        yield rig


def command(rig, tmp_path, *more):
    channel = ["--channel", CHANNEL, "--rig", rig.name, "--gripper", "linear_4310", "--out", tmp_path / "left.yaml"]
    known = ["--calibration", tmp_path / "stops.json", "--gravity-factor", *"111111"]
    return [sys.executable, "-m", "lerobot_robot_yam.commands.tune", *map(str, [*channel, *known, *more])]


def landed(rig):
    return not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())


def misses(path, true):
    """(POSES, n) Nm of an arm with that tuning, anywhere; and what may be missed there."""
    hardware = ResolvedArm(sim_config(argparse.Namespace(name="x"), CHANNEL, gravity_factor=None, tuning=str(path)))
    model = GravityModel(hardware.arm, hardware.gripper, load=hardware.load)
    low, high = hardware.arm.joint_limits_rad.T
    where = np.random.default_rng(8).uniform(low, high, (POSES, hardware.joints))
    weight = np.array([true.torque(q) for q in where])
    found = np.array([model.torque(q) for q in where]) * hardware.arm.gravity_factor
    return np.abs(found - weight), np.maximum(SHARE * np.abs(weight), STEPS * torque_steps(hardware))


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(20))
def test_twenty_arms_hold_as_they_should(made, tmp_path, seed):
    row = deviation(seed)
    rig, true = made(row)
    path, config, begin = tmp_path / "left.yaml", sim_config(rig, CHANNEL, hold_integral=False), rig.now()
    tuner = Tuner(config, "lockstep", SAFE, None, LEGS)
    found, before, poses = tuner.measure(guided=False)
    save_tuning(path, found.tuning)
    after = tuner.hold(found.tuning, poses)
    assert rig.now() - begin < MOST_S
    missed, may_miss = misses(path, true)
    assert (missed <= may_miss).all(), (missed / may_miss).max(axis=0)
    rubs = RUB_NM * np.array(row["friction"])
    np.testing.assert_allclose(found.tuning.coulomb_nm, rubs, atol=0.03)
    np.testing.assert_allclose(found.tuning.viscous_nm_s, VISCOUS_NM_S, atol=0.15)
    stuck = rubs / tuner.hardware.kp[:6]
    allowed = np.where(stuck < 0.5 * HOLD_RAD, HOLD_RAD, stuck + HOLD_RAD)
    assert (np.abs(after) <= allowed).all(), np.abs(after).max(axis=0)
    assert (np.abs(before).max(axis=0) > allowed).any()
    with YamArm(config, isolation="lockstep", tuning=str(path), hold_integral=True, gravity_factor=None) as arm:
        for pose in poses[:2]:
            arm.move_to(pose)
            arm.clock.sleep(SETTLE_S)
            state = arm.observe()
            assert (np.abs(state.setpoint_q - state.q) <= HOLD_RAD).all()


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_payload_is_found_on_an_arm_that_was_tuned_bare(made, tmp_path, capsys):
    rig, _ = made(deviation(1, payload_kg=0.0))
    config = sim_config(rig, CHANNEL)
    assert tune(config, options(tmp_path), "lockstep") == 0
    rig.fault(CHANNEL, None, "payload_kg", 0.3)
    more = options(tmp_path, out=tmp_path / "held.yaml", payload=tmp_path / "left.yaml")
    assert tune(config, more, "lockstep") == 0
    load = load_tuning(tmp_path / "held.yaml").payload
    assert load.mass_kg == pytest.approx(0.3, abs=0.01)
    np.testing.assert_allclose(load.com_m, 0.0, atol=0.01)
    assert "payload: 0.3" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("\nd\n", ["only: 1 poses are no way; give two at least, better eight"]),
        (
            "\n\nd\n",
            [
                "only: the data do not tell joint_1 (Coulomb friction, viscous friction), joint_2 (moment x, moment z",
                "the poses move only joint_1 by 0.00 rad",
                "Poses that would, in rad: [",
            ],
        ),
    ],
)
def test_guided_poses_that_tell_nothing_are_refused_before_the_arm_goes(made, tmp_path, monkeypatch, typed, words):
    rig, _ = made(None)
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    with pytest.raises(ConfigError) as refused:
        tune(sim_config(rig, CHANNEL), options(tmp_path, guided=True), "lockstep")
    assert all(word in str(refused.value) for word in words)
    assert landed(rig) and not (tmp_path / "left.yaml").exists()


@pytest.mark.long
def test_a_guided_pose_at_the_table_is_refused_and_the_arm_lands(live, tmp_path):
    save_stops("only", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))
    with Terminal(tmp_path, *command(live, tmp_path, "--guided")) as terminal:
        terminal.answer(("type tune to go on", b"tune\n"))
        for number, pose in enumerate((HIGH, LOW), 1):
            terminal.wait_shown(f"pose {number}:")
            live.lift(CHANNEL, pose, 2.0)
            time.sleep(4.0)
            terminal.type(b"\n")
        terminal.wait_shown("pose 3:")
        live.release(CHANNEL)
        terminal.answer(("", b"d\n"), ("on the way to pose 2 only", b""), ("of floor", b""))
        assert terminal.end() == 1
    assert landed(live) and not (tmp_path / "left.yaml").exists()


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.timeout(600)
def test_the_command_tunes_an_arm_that_lives(tmp_path):
    path = scene(tmp_path, deviation(0))
    save_stops("only", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))
    with running_rig(scene=path) as rig:
        picture = tmp_path / "tuning.png"
        done = subprocess.run(
            command(rig, tmp_path, "--yes", "--plot", picture), capture_output=True, text=True, timeout=500
        )
        assert done.returncode == 0, done.stderr[-4000:]
        assert landed(rig)
    assert len(re.findall(r"^joint_\d .*±", done.stdout, re.MULTILINE)) == 6 and "hold mrad: before" in done.stdout
    missed, may_miss = misses(tmp_path / "left.yaml", true_gravity(path))
    assert (missed <= may_miss).all(), (missed / may_miss).max(axis=0)
    assert picture.stat().st_size > 10_000


@pytest.mark.long
def test_an_interrupted_run_lands_the_arm_and_keeps_nothing(live, tmp_path):
    save_stops("only", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))
    process = subprocess.Popen(command(live, tmp_path, "--yes"), stderr=subprocess.PIPE)
    said = b""
    while b"measuring:   4%" not in said:
        said += os.read(process.stderr.fileno(), 4096)
        assert process.poll() is None, said
    process.send_signal(signal.SIGINT)
    said += process.communicate(timeout=60)[1]
    assert process.returncode == 130 and b"yam-tune: interrupted" in said
    assert landed(live) and not (tmp_path / "left.yaml").exists()


def test_what_cannot_be_done_is_said_before_anything_moves(tmp_path, capsys):
    channel, old = ["--channel", "can9", "--out", str(tmp_path / "new.yaml")], tmp_path / "old.yaml"
    old.write_text("")
    for arguments, says in [
        (channel, "there is no terminal to confirm at"),
        ([*channel, "--yes", "--tilt", "1.57", "0"], "with --tilt say where the table is: --floor-z"),
        ([*channel, "--yes", "--gripper", "linear_4310", "--arm", "none"], "arm 'none' has no joints to tune"),
        ([*channel, "--yes", "--gripper", "yom"], "yom"),
        ([*channel, "--yes", "--gripper", "linear_4310", "--payload", "absent.yaml"], "cannot read absent.yaml"),
        (
            ["--channel", "can9", "--out", str(tmp_path / "old.yaml"), "--yes", "--gripper", "linear_4310"],
            "give --force",
        ),
    ]:
        assert main(arguments) == 1
        assert says in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["old.yaml"]
    with pytest.raises(SystemExit):
        main([*channel, "--guided", "--yes"])


def test_what_the_engine_needs_is_asked_for(tmp_path, capsys, monkeypatch):
    from mujoco import sysid

    monkeypatch.delattr(sysid, "calculate_intervals")  # as mujoco leaves it without its extra
    assert main(["--channel", "can9", "--out", str(tmp_path / "new.yaml"), "--yes", "--gripper", "linear_4310"]) == 1
    err = capsys.readouterr().err
    assert "yam-tune needs mujoco.sysid" in err and install_extra("sysid") in err
