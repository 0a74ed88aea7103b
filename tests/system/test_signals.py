"""SIGTERM and SIGHUP end a session like Ctrl-C; a landing is not cut short."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.system.signals import end_session_on_signals, finished_first, undisturbed
from lerobot_robot_yam.yam_follower import YamFollower

ENDING = [signal.SIGTERM, signal.SIGHUP]


def raise_and_wait(number):
    os.kill(os.getpid(), number)
    time.sleep(0.2)


@pytest.mark.parametrize("number", ENDING)
def test_a_connected_robot_ends_and_lands(rig, tmp_path, number):
    config = YamFollowerConfig(
        channel="follower_left",
        interface="yam_sim",
        can_options={"rig": rig.name},
        gripper_stops_rad=[3.25, -3.3],
        calibration_dir=tmp_path,
    )
    robot = YamFollower(config)
    robot.connect()
    with pytest.raises(KeyboardInterrupt, match=signal.Signals(number).name):
        try:
            raise_and_wait(number)
        finally:
            robot.disconnect()
    assert signal.getsignal(number) is signal.SIG_DFL
    motors = rig.state()["arms"]["follower_left"]["motors"].values()
    assert not any(motor["enabled"] for motor in motors)


@pytest.mark.parametrize("number", ENDING)
def test_handlers_stay_until_the_last_device_is_gone(number):
    first, second = end_session_on_signals(), end_session_on_signals()
    first()
    first()
    with pytest.raises(KeyboardInterrupt):
        raise_and_wait(number)
    second()
    assert signal.getsignal(number) is signal.SIG_DFL


def test_the_users_own_handler_stays():
    seen = []
    before = signal.signal(signal.SIGTERM, lambda *_: seen.append(1))
    try:
        undo = end_session_on_signals()
        raise_and_wait(signal.SIGTERM)
        undo()
        raise_and_wait(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert len(seen) == 2


@pytest.mark.parametrize("number", [signal.SIGINT, *ENDING])
def test_nothing_disturbs_a_landing(number, caplog):
    before = signal.getsignal(number)
    with undisturbed("landing"):
        raise_and_wait(number)
    assert "landing" in caplog.text
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", [signal.SIGINT, *ENDING])
def test_what_has_to_be_finished_is_and_then_the_session_ends(number):
    before, finished = signal.getsignal(number), False
    with pytest.raises(KeyboardInterrupt), finished_first("saving"):
        raise_and_wait(number)
        finished = True
    assert finished and signal.getsignal(number) is before


def test_other_threads_leave_handlers_alone():
    def body():
        undo = end_session_on_signals()
        with undisturbed("landing"):
            found.append(signal.getsignal(signal.SIGTERM))
        undo()

    found = []
    thread = threading.Thread(target=body)
    thread.start()
    thread.join()
    assert found == [signal.SIG_DFL]


def test_one_wish_may_come_as_two_signals():
    """A terminal that closes sends several; a person who insists waits a moment."""
    asked = []
    undo = end_session_on_signals(lambda frame, why: not asked.append(why))
    try:
        for number in ENDING:
            raise_and_wait(number)
        time.sleep(1.0)
        with pytest.raises(KeyboardInterrupt):
            raise_and_wait(signal.SIGTERM)
    finally:
        undo()
    assert asked == ["ended by SIGTERM"]


def test_ctrl_c_stays_the_programs_own_unless_a_command_runs():
    undo = end_session_on_signals()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    undo()
    undo = end_session_on_signals(ctrl_c=True)
    with pytest.raises(KeyboardInterrupt, match="ended by SIGINT"):
        raise_and_wait(signal.SIGINT)
    undo()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("command", [True, False])
@pytest.mark.parametrize("kind", [StaleStateError, ZeroDivisionError])
def test_only_an_error_of_ours_that_ends_a_lerobot_command_is_one_line(command, kind):
    code = (
        "from lerobot_robot_yam.errors import StaleStateError\n"
        "from lerobot_robot_yam.system.signals import end_session_on_signals\n"
        f"end_session_on_signals(ctrl_c={command})()\n"
        f"raise {kind.__name__}('left_follower (can0): newest state is 0.52 s old')"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert run.returncode == 1
    if command and kind is StaleStateError:
        assert run.stderr == "error: left_follower (can0): newest state is 0.52 s old\n"
    else:
        assert "Traceback" in run.stderr
