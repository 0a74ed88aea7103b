"""However a command ends, the arms are landed and nothing is left behind."""

import os
import signal
import time

import pytest

from tests.cli.conftest import CALM
from tests.support.waiting import wait

pytestmark = pytest.mark.alone

TELEOPERATE = ["--config_path=configs/sim/teleoperate.yaml", *CALM]


def raise_leaders(commands):
    """Pull the leaders somewhere that is far from any rest, and let them float there; the followers follow."""
    for side, turn in (("left", 0.4), ("right", -0.4)):
        pose = [turn, 1.2, 1.1, -0.5, 0.2, 0.3]
        commands.rig.hand(f"leader_{side}", [2.0], [pose])
    time.sleep(3.0)
    deadline = time.monotonic() + 30.0
    arms = commands.rig.state()["arms"]
    while arms["follower_left"]["q"][1] < 0.8 or arms["follower_right"]["q"][0] > -0.2:
        assert time.monotonic() < deadline, arms
        time.sleep(0.1)
        arms = commands.rig.state()["arms"]
    for side in ("left", "right"):
        commands.rig.release(f"leader_{side}")


@pytest.mark.long
def test_teleoperate_runs_at_60_hz_under_the_operators_hands_and_ends_by_itself(shared_commands):
    commands = shared_commands
    status = commands.run("lerobot-teleoperate", TELEOPERATE[0], "--fps=60", "--teleop_time_s=20")
    assert status == 0, commands.output()[-4000:]
    assert commands.output().count("Teleop loop time") >= 0.95 * 20 * 60
    assert "control loop:" in commands.output()  # the statistics of every session
    assert not [event for event in commands.rig.events() if event["kind"] == "motor_fault"]
    commands.assert_landed()


@pytest.mark.parametrize(
    "first, second",
    [
        pytest.param(
            signal.SIGINT, signal.SIGINT, marks=pytest.mark.long
        ),  # of a recording: test_interrupted_recording
        pytest.param(signal.SIGTERM, None, marks=pytest.mark.long),  # of a robot alone: tests/system/test_signals.py
        pytest.param(signal.SIGHUP, signal.SIGTERM, marks=pytest.mark.long),
    ],
)
def test_signals_land_the_arms(commands, first, second):
    process = commands.start("lerobot-teleoperate", *TELEOPERATE, "--teleop_time_s=120")
    commands.wait_connected(process)
    raise_leaders(commands)
    os.killpg(process.pid, first)  # as a terminal does: the whole foreground group
    if second is not None:
        time.sleep(0.7)
        os.killpg(process.pid, second)
    assert commands.finish(process) == 0, commands.output()[-4000:]  # lerobot-teleoperate takes Ctrl-C for an end
    commands.assert_landed()


CALLER = """
import time
from pathlib import Path
from lerobot_robot_yam import BiYamFollower, BiYamFollowerConfig
from lerobot_robot_yam.config_yam_follower import FollowerArmConfig

arm = {{"interface": "yam_sim", "gravity_factor": [1.0] * 6}}
arms = {{f"{{side}}_arm_config": FollowerArmConfig(channel=f"follower_{{side}}", **arm) for side in ("left", "right")}}
robot = BiYamFollower(BiYamFollowerConfig(calibration_dir=Path({directory!r}), **arms))
robot.connect()
deadline = time.monotonic() + 2.0
while time.monotonic() < deadline:
    robot.send_action({{**robot.get_observation(), "left_joint_2.pos": 1.0, "right_joint_3.pos": 0.8}})
    time.sleep(0.02)
{ending}
"""


@pytest.mark.long
@pytest.mark.parametrize("ending", ["raise RuntimeError('a bug of the caller')", "import os; os._exit(1)"])
def test_a_failing_caller_lands_the_arms(commands, ending):
    process = commands.start("-c", CALLER.format(directory=str(commands.directory), ending=ending))
    commands.wait_enabled(process, "follower_left", "follower_right")
    assert commands.finish(process) == 1
    wait(lambda: not commands.enabled(), 20.0, "nobody landed the arms")
    commands.assert_landed()


@pytest.mark.long
def test_calibrate_stores_the_stops(commands):
    status = commands.run("lerobot-calibrate", "--config_path=configs/sim/calibrate.yaml")
    assert status == 0, commands.output()[-4000:]
    stored = commands.directory / "cal" / "robots" / "bi_yam_follower" / "yam"
    assert sorted(path.name for path in stored.iterdir()) == ["left_sim_gripper.json", "right_sim_gripper.json"]
    commands.assert_landed()
