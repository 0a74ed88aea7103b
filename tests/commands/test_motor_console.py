"""yam-motors console and monitor: the keys, the motor on the rig, and what is heard beside a session."""

import contextlib
import io
import signal
import sys

import can
import pytest

from lerobot_robot_yam.commands.lib.key_terminal import DOWN, LEFT, RIGHT, UP
from lerobot_robot_yam.commands.lib.motor import motor_console
from lerobot_robot_yam.commands.lib.motor.motor_console import SPEED_RAD_S, Knob
from lerobot_robot_yam.commands.lib.motor.motor_monitor import Traffic
from lerobot_robot_yam.commands.motors import main
from lerobot_robot_yam.damiao.codec import decode_mit
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from tests.support.crooked_arm import arguments, config, events, motor_rad
from tests.support.terminal import Terminal

STEP_RAD = 25.0 / 65535


# the keys


def knob(**fields):
    return Knob("DM4310", **{"start_rad": 1.0, "range_rad": 0.5, "torque_nm": 3.0} | fields)


def press(knob, *keys):
    for key in keys:
        knob.press(key)


def asked(knob, q=1.0, elapsed_s=0.01):
    return decode_mit("DM4310", knob.command(q, elapsed_s))


def test_the_setpoint_goes_to_the_target_at_a_limited_speed():
    turned = knob()
    assert asked(turned).position == pytest.approx(1.0, abs=STEP_RAD)  # at first it asks the motor to stay
    press(turned, RIGHT, RIGHT)
    assert asked(turned).position == pytest.approx(1.0 + SPEED_RAD_S * 0.01, abs=STEP_RAD)
    for _ in range(100):
        command = asked(turned, q=turned.setpoint_rad)
    assert command.position == pytest.approx(1.1, abs=STEP_RAD)


def test_a_motor_that_is_blocked_is_not_pushed_harder_than_allowed():
    turned = knob(kp=50.0, torque_nm=1.0)
    press(turned, *[RIGHT] * 10)
    for _ in range(500):
        command = asked(turned, q=1.0)
    assert command.kp * (command.position - 1.0) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("key", "end"), [(LEFT, 0.5), (RIGHT, 1.5)])
def test_the_target_stays_within_the_range(key, end):
    turned = knob()
    press(turned, UP, UP, *[key] * 20)
    assert turned.target == end
    asked(turned)
    press(turned, " ")
    assert turned.target == turned.setpoint_rad == pytest.approx(1.0, abs=0.01)  # a load must not pull it along


def test_step_and_gains_stay_between_their_ends():
    turned = knob()
    press(turned, *[UP] * 9, *"K" * 50, *"D" * 50)
    command = asked(turned)
    assert (turned.step, command.kp, command.kd) == (0.2, pytest.approx(100, abs=0.2), pytest.approx(5, abs=0.01))
    press(turned, *[DOWN] * 9, *"k" * 50, *"d" * 50, "x")
    assert (turned.step, turned.kp, turned.kd) == (0.01, 1.0, 0.1)


# the motor


class Keys:
    """A terminal in the rig's time. `script`: when, s, and the keys, or what happens then; it quits at the end.

    wakes_s: time between keys that do nothing, as of a text that is pasted.
    """

    gone = False

    def __init__(self, rig, script, wakes_s=1.0):
        self._rig, self._script, self._wakes_s, self._begin_s = rig, [*script], wakes_s, None

    def keys(self, within_s):
        self._begin_s = self._begin_s or self._rig.now()
        self._rig.sleep(min(within_s, self._wakes_s))
        if not self._script:
            return ["q"]
        if self._rig.now() - self._begin_s < self._script[0][0]:
            return ["x"]
        _, then = self._script.pop(0)
        return then() or [] if callable(then) else then


@pytest.fixture
def console(arm, type_in, monkeypatch, capsys):
    """Runs `yam-motors console` for joint 6 in lock-step; returns its exit status and what it has said."""

    def run(script, *more, **options):
        type_in(b"enable\n")
        terminal = contextlib.nullcontext(Keys(arm, script, **options))
        monkeypatch.setattr(motor_console, "key_terminal", lambda: terminal)
        status = main(["console", "--motor", "joint_6", *more, *arguments(arm)])
        return status, capsys.readouterr().err

    return run


def enabled(rig):
    return [name for name, motor in rig.state()["arms"]["only"]["motors"].items() if motor["enabled"]]


@pytest.mark.parametrize("wakes_s", [1.0, 0.001])
def test_one_motor_follows_the_arrow_keys_and_is_let_down(arm, console, wakes_s):
    """No faster than it may, also when keys that come fast wake the loop each time."""
    before, seen = motor_rad(arm)["joint_6"], []

    def look():
        seen.append((motor_rad(arm)["joint_6"] - before, enabled(arm)))

    script = [(0.1, [UP, *[RIGHT] * 8]), (1.1, look), (4.0, look)]  # steps of 0.1 rad
    status, said = console(script, "--range", "1.5", wakes_s=wakes_s)
    assert status == 0 and "HANGS" not in said and "joint_6 is limp" in said and enabled(arm) == []
    (early, one), (late, _) = seen
    assert one == ["joint_6"] and 0.3 < early < SPEED_RAD_S * 1.05
    assert late == pytest.approx(0.8, abs=0.08)  # friction keeps it a little short
    assert main(["read", "CTRL_MODE", *arguments(arm)]) == 0  # nobody holds the channel


def test_a_motor_that_misses_its_end_is_told_again(arm, console):
    """Ctrl-Z would stop the program, so that the joint would fall: it quits."""
    before, pause = motor_rad(arm)["joint_6"], arm.sleep

    def deaf():
        arm.fault("only", "joint_6", "command_loss_rate", 1.0)
        ends_s = arm.now() + 0.2

        def sleep(seconds):
            pause(seconds)
            if arm.now() > ends_s:
                arm.fault("only", "joint_6", "command_loss_rate", 0.0)

        arm.sleep = sleep
        return ["\x1a"]

    assert console([(0.1, [RIGHT] * 6), (0.6, deaf)], "--range", "3")[0] == 0
    assert enabled(arm) == [] and 0.1 < motor_rad(arm)["joint_6"] - before < 0.4


def test_a_motor_that_fails_is_told_and_left_limp(arm, console):
    status, said = console([(0.5, lambda: arm.fault("only", "joint_6", "nibble", 0xA) and None)])
    assert status == 1 and "only: joint_6 has let go: 0xA over-current" in said and enabled(arm) == []


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.long), signal.SIGKILL])
def test_a_signal_lets_the_joint_down_and_a_kill_leaves_it_to_its_watchdog(live_arm, tmp_path, number):
    command = [sys.executable, "-m", "lerobot_robot_yam.commands.motors", "console", "--motor", "joint_6"]
    with Terminal(tmp_path, *command, *arguments(live_arm)) as terminal:
        terminal.answer(("Type enable to energise joint_6", b"enable\n"), ("target", b""))
        seen = len(live_arm.events())
        terminal.kill(number)
        terminal.end()
        if number == signal.SIGKILL:
            live_arm.wait_event("motor_fault", 5.0, since=seen)
    assert enabled(live_arm) == []
    assert main(["read", "CTRL_MODE", *arguments(live_arm)]) == 0  # nobody holds the channel


# what speaks against energising


def refused(rig, capsys, *more):
    capsys.readouterr()
    assert main(["console", *more, *arguments(rig)]) == 1
    assert not events(rig, "motor_enabled")
    return capsys.readouterr().err


def test_an_arm_in_the_air_is_said_to_be_and_asked_about(arm, capsys, type_in):
    arm.set_pose("only", q=[0.0, 1.2, 1.2, 0.0, 0.0, 0.0])
    type_in(b"enable\n")
    said = refused(arm, capsys, "--motor", "joint_6")
    assert "Type in the air to energise joint_6" in said and "not confirmed; nothing was energised" in said
    assert "THE ARM HANGS IN THE AIR OR IS HELD UP: joint_" in said


def test_what_happens_while_the_question_waits_counts(arm, capsys, monkeypatch):
    class Person(io.StringIO):
        def readline(self):
            EmergencyStop().latch("somebody shouted")
            return "enable\n"

        def isatty(self):
            return True

    monkeypatch.setattr("sys.stdin", Person())
    said = refused(arm, capsys, "--motor", "joint_6")
    EmergencyStop().release()
    assert "Type enable" in said and "the emergency stop is latched: somebody shouted" in said


def test_what_speaks_against_energising_is_named(arm, capsys, monkeypatch):
    assert "no terminal to confirm at" in refused(arm, capsys, "--motor", "joint_6")
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    assert "name one motor (--motor joint_6)" in refused(arm, capsys)
    assert "not by 4" in refused(arm, capsys, "--motor", "joint_6", "--range", "4")
    EmergencyStop().latch("somebody shouted")
    assert "the emergency stop is latched: somebody shouted" in refused(arm, capsys, "--motor", "joint_6")
    EmergencyStop().release()
    for counts, lasts in ((0, "for ever"), (200_000, "for 10 s"), (2**32 - 1, "for 214748 s")):
        arm.fault("only", "joint_6", "register", counts, register=int(Register.TIMEOUT))
        said = refused(arm, capsys, "--motor", "joint_6")
        assert f"joint_6 goes on {lasts} if this program dies; set its time-out first" in said
    arm.fault("only", "joint_2", "nibble", 0xC)
    assert "joint_2 (id 2) reports 0xC" in refused(arm, capsys, "--motor", "joint_6")


# what is heard


def frame(identifier, at_s, **kinds):
    return can.Message(arbitration_id=identifier, data=bytes(8), timestamp=at_s, is_extended_id=False, **kinds)


def test_an_answer_belongs_to_the_command_before_it():
    frames = [frame(3, tick * 0.004) for tick in range(10)]
    frames += [frame(19, tick * 0.004 + 0.001) for tick in range(10) if tick != 5]
    figures = Traffic(sorted(frames, key=lambda heard: heard.timestamp)).figures()[3]
    assert (figures["commands"], figures["lost"]) == (10, 1)
    assert figures["latency_ms_max"] == pytest.approx(1.0) and figures["period_ms_p50"] == pytest.approx(4.0)


def test_commands_of_every_mode_count_other_frames_do_not_and_what_nothing_tells_is_no_figure():
    heard = [frame(identifier, 1.0) for identifier in (3, 0x103, 0x203, 0x303, 0x7FF, 0x50E)]
    traffic = Traffic([*heard, frame(0x40, 1.0, is_error_frame=True)])
    assert traffic.figures()[3]["commands"] == 4 and traffic.others == {0x7FF: 1, 0x50E: 1}
    assert (traffic.frames, traffic.error_frames) == (6, 1)
    assert Traffic([frame(19, 1.0)]).figures()[3]["latency_ms_max"] is None
    figures = Traffic([frame(3, tick * 0.004) for tick in range(3)]).figures()[3]
    assert (figures["lost"], figures["latency_ms_p99"]) == (2, None) and figures["period_ms_max"] == 4.0


def test_monitor_listens_beside_a_session_whose_channel_is_in_use(live_arm, capsys):
    assert main(["monitor", "--seconds", "0.2", *arguments(live_arm)]) == 1
    assert "nothing was heard on channel only within 0.2 s: no session drives it" in capsys.readouterr().err
    with YamArm(config(live_arm)):
        live_arm.fault("only", "joint_3", "loss_rate", 0.2)
        assert main(["monitor", "--seconds", "1.5", *arguments(live_arm)]) == 0
        live_arm.clear_faults("only")
        lines = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines()}
        commands, lost, latency_ms = (float(text) for text in lines["joint_3"][1:4])
        assert 0.1 < lost / commands < 0.3 and 0.2 < latency_ms < 3.0
        assert lines["joint_1"][2] == "0"
        assert main(["scan", *arguments(live_arm)]) == 1
        assert "in use by process" in capsys.readouterr().err
