"""yam-waldo with an arm on a live rig: programs that are killed leave it held or landed; one arm has one master."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops, save_stops
from lerobot_robot_yam.control.landing.landing_move import LANDING_SPEED_RAD_S
from lerobot_robot_yam.errors import ControllerError, YamError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.waldo.wire import ask_once, ask_operator_door, door_path
from scripts import recorders
from tests.support.paths import ROOT
from tests.support.rigged import STOPS, arm_on
from tests.support.waiting import wait
from tests.waldo.conformance import HOST, free_port

pytestmark = [pytest.mark.long, pytest.mark.alone, pytest.mark.usefixtures("waldoctl")]

ARM = "follower_left"
POSE = [0.1, 0.9, 0.9, -0.3, 0.1, 0.1]
STILL_RAD_S = np.radians(20.0)
_JOGGER = """
import sys, time
from lerobot_robot_yam import RobotClient
rbt = RobotClient(port=int(sys.argv[1]))
while True:
    rbt.jog_j(0, speed=0.3, duration=0.1)
    time.sleep(0.05)
"""
_WATCHER = """
import asyncio, sys
from lerobot_robot_yam import AsyncRobotClient
async def watch():
    async for _ in AsyncRobotClient(port=int(sys.argv[1])).stream_status_shared():
        pass
asyncio.run(watch())
"""
_HOST = """
import sys, time
from lerobot_robot_yam.waldo.robot import Robot
robot = Robot(normalize_logs=True)
robot.start(host="127.0.0.1", port=int(sys.argv[1]), com_port="")
time.sleep(600)
"""


@pytest.fixture(scope="module")
def live():
    with running_rig(arms=[ARM]) as rig:
        yield rig


@pytest.fixture
def rig(live):
    live.set_pose(ARM, POSE, 0.5)
    return live


@contextlib.contextmanager
def started(*command):
    """A process; it is killed in the end."""
    with subprocess.Popen([sys.executable, *map(str, command)], cwd=ROOT, env=environment()) as process:
        try:
            yield process
        finally:
            process.kill()


def environment():
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "tests" / "waldo" / "stub"), str(ROOT)])}


@contextlib.contextmanager
def controller(rig, tmp_path):
    """`yam-waldo` for the arm on the rig, which is not armed; its port, and the process. It lands in the end."""
    port = free_port()
    save_stops("arm", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))
    options = ["--hardware", "--channel", ARM, "--rig", rig.name, "--gripper", "linear_4310", "--no-page"]
    command = ["-m", "lerobot_robot_yam.commands.pages.waldo", *options, "--calibration", tmp_path / "stops.json"]
    with started(*command, "--port", port) as process:
        wait(lambda: ask_once(HOST, port, "ping") or process.poll() is not None, 30.0)
        try:
            yield port, process
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60.0)


@contextlib.contextmanager
def driving(rig, tmp_path):
    """A client whose commands move the arm, which is in the air; the controller's port and process."""
    from lerobot_robot_yam import RobotClient

    with controller(rig, tmp_path) as (port, process), RobotClient(HOST, port) as rbt:
        ask_operator_door(port, "arm")
        rbt.simulator(False)
        rbt.reset()
        rbt.home(wait=True)
        yield rbt, port, process


def true_q(rig):
    return np.array(rig.state()["arms"][ARM]["q"])[:6]


def enabled(rig):
    return [motor["enabled"] for motor in rig.state()["arms"][ARM]["motors"].values()]


def test_a_jogging_script_that_is_killed_leaves_the_arm_standing(rig, tmp_path):
    with driving(rig, tmp_path) as (rbt, port, _), started("-c", _JOGGER, port) as script:
        wait(lambda: max(np.abs(rbt.joint_speeds())) > 3.0)
        script.kill()
        time.sleep(0.5)
        held = true_q(rig)
        recorders.watch_start(rig, ARM)
        time.sleep(2.0)
        assert np.abs(true_q(rig) - held).max() < np.radians(0.5)
        assert max(recorders.watch(rig, ARM)["max_speed_rad_s"][:6]) < np.radians(2.0) and all(enabled(rig))


def test_a_page_that_is_killed_leaves_the_arm_held(rig, tmp_path):
    with driving(rig, tmp_path) as (rbt, port, _), started("-c", _WATCHER, port) as page:
        time.sleep(4.0)
        held = true_q(rig)
        page.kill()
        time.sleep(1.0)
        assert (
            np.abs(true_q(rig) - held).max() < np.radians(0.3) and all(enabled(rig)) and rbt.ping().hardware_connected
        )


def test_a_controller_that_is_killed_in_a_move_leaves_an_arm_that_lands(rig, tmp_path):
    with driving(rig, tmp_path) as (rbt, port, process):
        rbt.move_j([60, 60, 60, -20, 0, 0], speed=0.3)
        wait(lambda: max(np.abs(rbt.joint_speeds())) > 10.0)
        recorders.watch_start(rig, ARM)
        process.kill()
        door_path(port).unlink()  # else the next controller on this port replaces it
        wait(lambda: not any(enabled(rig)), 30.0)
        seen = recorders.watch(rig, ARM)
        assert max(seen["max_speed_rad_s"][:6]) < 1.2 * LANDING_SPEED_RAD_S
        landed = true_q(rig)
        time.sleep(0.5)
        assert np.abs(true_q(rig) - landed)[1:].max() < 0.05  # cut where it lies


def test_ctrl_c_lands_the_arm(rig, tmp_path):
    with driving(rig, tmp_path) as (_, _, process):
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 0
        assert not any(enabled(rig)) and np.abs(true_q(rig)[1:3]).max() < 0.1


def test_an_arm_that_another_program_drives_cannot_be_armed_and_the_reverse(rig, tmp_path):
    with controller(rig, tmp_path) as (port, _):
        with (
            arm_on(rig, ARM),
            pytest.raises(ControllerError, match=r"in use by process \d+, which drives it for .*, process"),
        ):
            ask_operator_door(port, "arm")
        rig.set_pose(ARM, POSE, 0.5)
        ask_operator_door(port, "arm")
        words = r"in use by process \d+, which drives it for lerobot_robot_yam.commands.pages.waldo, process \d+"
        with pytest.raises(YamError, match=words):
            arm_on(rig, ARM).connect()


def test_a_controller_in_simulator_mode_ends_with_its_host():
    port = free_port()
    with started("-c", _HOST, port) as host:
        wait(lambda: ask_once(HOST, port, "ping"))
        pid = ask_once(HOST, port, "ping")["pid"]
        host.kill()
        wait(lambda: not os.path.exists(f"/proc/{pid}"), 10.0)
