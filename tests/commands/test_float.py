"""yam-float at a terminal, on the rig: a scripted hand moves the arm, which does the same again by itself."""

import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.commands.float import main
from lerobot_robot_yam.control.gripper.homing import GripperStops
from lerobot_robot_yam.control.gripper.stored_stops import save_stops
from lerobot_robot_yam.session.trajectory_file import load_trajectory
from tests.support.crooked_arm import STOPS, arguments, events
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.terminal import Terminal

RAISED = [0.2, 0.9, 0.8, -0.3, 0.1, 0.2]
WAVED = [-0.3, 1.2, 1.1, 0.2, -0.2, -0.3]
MOST_RAD = 0.005


@pytest.fixture
def console(tmp_path):
    """Starts `yam-float` for arms of a rig in a terminal."""
    opened = []
    save_stops("arm", tmp_path / "stops.json", "linear_4310", GripperStops(*STOPS))

    def start(rig, *more, stops=("stops.json",), **options):
        command = [sys.executable, "-m", "lerobot_robot_yam.commands.float", "--calibration", *stops]
        opened.append(Terminal(tmp_path, *command, *arguments(rig), *more, cwd=tmp_path, **options))
        return opened[0]

    yield start
    for terminal in opened:
        terminal.close()


def true_q(rig):
    return np.array(rig.state()["arms"]["only"]["q"])[:6]


def begin(terminal):
    terminal.wait_shown("Type float to go on:")
    terminal.type(b"float\n")
    terminal.wait_shown("only (only): FLOAT")


def test_what_a_hand_does_is_recorded_saved_loaded_and_replayed(arm, console, tmp_path):
    terminal = console(arm)
    begin(terminal)
    arm.lift("only", RAISED, 1.5)
    arm.wait_event("hand_arrived", 10.0)
    arm.truth_start("only", 60.0)
    terminal.type(b"r")
    terminal.wait_shown("RECORDING")
    began = time.monotonic()
    for pose in (WAVED, RAISED):
        arm.lift("only", pose, 2.0)
        time.sleep(2.6)
    recorded_end = true_q(arm)
    terminal.type(b"r")
    terminal.wait_shown("recorded ")
    ended = time.monotonic()
    arm.release("only")
    terminal.type(b"s")
    terminal.wait_shown("saved to trajectory.npy")
    arm.lift("only", [0.0, 0.6, 0.6, 0.0, 0.0, 0.0], 1.5, then_release=True)
    time.sleep(2)
    terminal.type(b"l\n")
    terminal.wait_shown("loaded trajectory.npy")
    terminal.type(b"p")
    terminal.wait_shown("REPLAYING")
    began2 = time.monotonic()
    terminal.wait_shown("replayed; the arm holds")
    ended2 = time.monotonic()
    time.sleep(2.0)
    print("END", np.abs(true_q(arm) - recorded_end).max() * 1e3)
    truth = arm.truth("only")
    np.savez("/tmp/floatpy_truth.npz", marks=[began, ended, began2, ended2], **truth)
    terminal.type(b"q")
    assert terminal.end() == 0
    print(terminal.shown[-3000:])
    assert moved_after_cut_m(arm, "only") < MOST_M
