"""yam-motors console and monitor, on the rig: the only action that energises anything."""

import signal
import sys
import time

import pytest

from lerobot_robot_yam.commands.lib.motor.motor_knob import SPEED_RAD_S
from lerobot_robot_yam.commands.motors import main
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from tests.support.crooked_arm import arguments, config, events, motor_rad
from tests.support.terminal import Terminal

UP, RIGHT = b"\x1b[A", b"\x1b[C"


@pytest.fixture
def console(arm, tmp_path):
    """Starts `yam-motors console` for joint 6 in a terminal."""
    opened = []

    def start(*more):
        command = [sys.executable, "-m", "lerobot_robot_yam.commands.motors", "console", "--motor", "joint_6"]
        opened.append(Terminal(tmp_path, *command, *arguments(arm), *more))
        return opened[0]

    yield start
    for terminal in opened:
        terminal.close()


def enabled(rig):
    return [name for name, motor in rig.state()["arms"]["only"]["motors"].items() if motor["enabled"]]


def test_one_motor_follows_the_arrow_keys_and_is_let_down(arm, console):
    before = motor_rad(arm)
    terminal = console()
    terminal.wait_shown("Type enable to energise joint_6")
    assert "HANGS" not in terminal.shown and not events(arm, "motor_enabled")
    terminal.type(b"enable\n")
    terminal.wait_shown("target")
    assert enabled(arm) == ["joint_6"]
    terminal.type(RIGHT * 5)
    deadline = time.monotonic() + 10.0
    while motor_rad(arm)["joint_6"] - before["joint_6"] < 0.22:  # friction keeps it a little short of 0.25
        assert time.monotonic() < deadline, terminal.shown
    terminal.wait_shown(f" q {before['joint_6'] + 0.2:+.1f}")
    terminal.type(b"q")
    terminal.wait_shown("joint_6 is limp")
    assert terminal.end() == 0 and enabled(arm) == []
    first, last = terminal.modes()
    assert first == last
    assert motor_rad(arm)["joint_6"] - before["joint_6"] == pytest.approx(0.25, abs=0.05)
    assert main(["read", "CTRL_MODE", *arguments(arm)]) == 0  # nobody holds the channel


def test_keys_that_come_fast_do_not_make_the_motor_fast(arm, console):
    """A key that is held down, or a text that is pasted: each key wakes the loop."""
    terminal = console("--range", "1.5")
    terminal.wait_shown("Type enable")
    terminal.type(b"enable\n")
    terminal.wait_shown("target")
    terminal.type(UP * 2 + RIGHT * 6)
    before, begin_s = motor_rad(arm)["joint_6"], time.monotonic()
    while time.monotonic() - begin_s < 1.0:
        terminal.type(b"x")
        time.sleep(0.001)
    moved, seconds = motor_rad(arm)["joint_6"] - before, time.monotonic() - begin_s
    assert moved < 1.1 * SPEED_RAD_S * seconds + 0.1
    terminal.type(b"q")
    assert terminal.end() == 0


@pytest.mark.long
def test_a_motor_that_misses_its_end_is_told_again(arm, console):
    terminal = console("--range", "3")
    terminal.wait_shown("Type enable")
    terminal.type(b"enable\n")
    terminal.wait_shown("target")
    terminal.type(RIGHT * 6)
    terminal.wait_shown(" q +0.2")
    arm.fault("only", "joint_6", "command_loss_rate", 1.0)
    terminal.type(b"\x1a")  # Ctrl-Z would stop the program, so that the joint would fall: it quits
    time.sleep(0.2)
    arm.fault("only", "joint_6", "command_loss_rate", 0.0)
    before = motor_rad(arm)["joint_6"]
    assert terminal.end() == 0 and enabled(arm) == []
    assert motor_rad(arm)["joint_6"] - before < 0.3


def test_an_arm_in_the_air_is_said_to_be_and_asked_about(arm, console):
    arm.set_pose("only", q=[0.0, 1.2, 1.2, 0.0, 0.0, 0.0])
    terminal = console()
    terminal.wait_shown("Type in the air to energise joint_6")
    assert "THE ARM HANGS IN THE AIR OR IS HELD UP: joint_" in terminal.shown
    terminal.type(b"enable\n")
    assert terminal.end() == 1
    assert "not confirmed; nothing was energised" in terminal.shown and not events(arm, "motor_enabled")


def test_what_happens_while_the_question_waits_counts(arm, console):
    terminal = console()
    terminal.wait_shown("Type enable")
    EmergencyStop().latch("somebody shouted")
    terminal.type(b"enable\n")
    assert terminal.end() == 1
    EmergencyStop().release()
    assert "the emergency stop is latched: somebody shouted" in terminal.shown and not events(arm, "motor_enabled")


@pytest.mark.long
def test_a_motor_that_fails_is_told_and_left_limp(arm, console):
    terminal = console()
    terminal.wait_shown("Type enable")
    terminal.type(b"enable\n")
    terminal.wait_shown("target")
    arm.fault("only", "joint_6", "nibble", 0xA)
    terminal.wait_shown("only: joint_6 has let go: 0xA over-current")
    assert terminal.end() == 1 and enabled(arm) == []


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.long), signal.SIGKILL])
def test_a_signal_lets_the_joint_down_and_a_kill_leaves_it_to_its_watchdog(arm, console, number):
    terminal = console()
    terminal.wait_shown("Type enable")
    terminal.type(b"enable\n")
    terminal.wait_shown("target")
    terminal.kill(number)
    terminal.end()
    if number == signal.SIGKILL:
        arm.wait_event("motor_fault", 5.0)
    assert enabled(arm) == []
    assert main(["read", "CTRL_MODE", *arguments(arm)]) == 0  # nobody holds the channel


def refused(rig, capsys, action, *more):
    capsys.readouterr()
    assert main([action, *more, *arguments(rig)]) == 1
    assert not events(rig, "motor_enabled")
    return capsys.readouterr().err


def test_what_speaks_against_energising_is_named(arm, capsys, monkeypatch):
    assert "no terminal to confirm at" in refused(arm, capsys, "console", "--motor", "joint_6")
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    assert "name one motor (--motor joint_6)" in refused(arm, capsys, "console")
    assert "not by 4" in refused(arm, capsys, "console", "--motor", "joint_6", "--range", "4")
    EmergencyStop().latch("somebody shouted")
    assert "the emergency stop is latched: somebody shouted" in refused(arm, capsys, "console", "--motor", "joint_6")
    EmergencyStop().release()
    for counts, lasts in ((0, "for ever"), (200_000, "for 10 s"), (2**32 - 1, "for 214748 s")):
        arm.fault("only", "joint_6", "register", counts, register=int(Register.TIMEOUT))
        said = refused(arm, capsys, "console", "--motor", "joint_6")
        assert f"joint_6 goes on {lasts} if this program dies; set its time-out first" in said
    arm.fault("only", "joint_2", "nibble", 0xC)
    assert "joint_2 (id 2) reports 0xC" in refused(arm, capsys, "console", "--motor", "joint_6")


def test_monitor_listens_beside_a_session(arm, capsys):
    assert main(["monitor", "--seconds", "0.2", *arguments(arm)]) == 1
    assert "nothing was heard on channel only within 0.2 s: no session drives it" in capsys.readouterr().err
    with YamArm(config(arm)):
        arm.fault("only", "joint_3", "loss_rate", 0.2)
        arm.trace_start("only")
        assert main(["monitor", "--seconds", "1.5", *arguments(arm)]) == 0
        lines = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines()}
        commands, lost, latency_ms = (float(text) for text in lines["joint_3"][1:4])
        assert 0.1 < lost / commands < 0.3 and 0.2 < latency_ms < 3.0
        assert lines["joint_1"][2] == "0"
