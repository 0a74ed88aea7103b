"""The lock that keeps a computer awake: asked of a stand-in for systemd's command, which the machines here may lack."""

import logging
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import BusError
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.system import sleep_lock
from lerobot_robot_yam.system.sleep_lock import SleepLock, can_sleep, kept_awake

ALL = "sleep:idle:handle-lid-switch"
STAND_IN = """#!/bin/sh
[ "$1" = --version ] && {{ echo "systemd {version} ({version}.1-1)"; echo "+PAM"; exit; }}
echo "$@" >> {log}
{hang}
for word; do case $word in --what=*) what=${{word#--what=}};; --*) ;; *) break;; esac; shift; done
case " {refused} " in *" $what "*) exit 1;; esac
trap '' TERM
"$@"
echo ended >> {log}
"""


@pytest.fixture
def inhibit(tmp_path, monkeypatch):
    """Puts a `systemd-inhibit` on the path that refuses some wishes; returns what it was asked for."""
    log, states = tmp_path / "asked", tmp_path / "state"
    states.write_text("freeze mem disk\n")
    monkeypatch.setattr(sleep_lock, "STATES", states)
    monkeypatch.setattr(sleep_lock, "SUSPEND", tmp_path / "suspend.target")

    def install(refused: str = "", version: str = "257", hang: str = "") -> Path:
        program = tmp_path / "systemd-inhibit"
        program.write_text(STAND_IN.format(log=log, refused=refused, version=version, hang=hang))
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
        return log

    return install


def lines(log: Path) -> list[str]:
    return log.read_text().splitlines() if log.exists() else []


def await_end(log: Path) -> None:
    deadline = time.monotonic() + 5.0
    while "ended" not in lines(log):
        assert time.monotonic() < deadline, lines(log)
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("refused", "version", "granted", "enough"),
    [
        ("", "257", ALL, True),
        ("", "256", ALL, False),  # a desktop of the same user suspends all the same
        ("", "", ALL, False),
        (ALL, "257", "sleep:idle", False),
        (f"{ALL} sleep:idle", "257", "idle", False),
        (f"{ALL} sleep:idle idle", "257", "", False),
    ],
)
def test_the_lock_holds_all_that_is_granted_until_it_is_released(inhibit, refused, version, granted, enough):
    log = inhibit(refused, version)
    lock = SleepLock()
    assert lock.granted() == (granted, enough)
    assert "ended" not in lines(log)
    lock.release()
    if granted:
        await_end(log)
    assert len([line for line in lines(log) if line.startswith("--what=")]) == 1 + len(refused.split()) - (not granted)


def test_the_death_of_its_holder_ends_it(inhibit):
    log = inhibit()
    code = (
        "from lerobot_robot_yam.system.sleep_lock import SleepLock; print(*SleepLock().granted(), flush=True); input()"
    )
    holder = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert b"sleep" in holder.stdout.readline()
    assert "ended" not in lines(log)
    holder.kill()
    holder.communicate()
    await_end(log)


def test_a_child_does_not_keep_a_lock_that_its_parent_releases(inhibit):
    log = inhibit()
    lock = SleepLock()
    assert lock.granted()[0]
    with subprocess.Popen(["sleep", "60"], pass_fds=[lock._end.fileno()]) as child:  # what a fork inherits
        lock.release()
        assert lock._holder.poll() is not None
        child.kill()
    assert sum(line.startswith("--what=") for line in lines(log)) == 1  # nothing less is asked for then


def test_who_is_not_answered_is_not_held_up(inhibit, monkeypatch):
    inhibit(hang="exec sleep 60")
    monkeypatch.setattr(sleep_lock, "_ANSWER_S", 0.2)
    lock, begin = SleepLock(), time.monotonic()
    assert lock.granted() == ("", False)
    lock.release()
    assert time.monotonic() - begin < 30.0 and lock._holder.poll() is not None


@pytest.mark.parametrize(("refused", "level"), [("", logging.INFO), (ALL, logging.WARNING)])
def test_the_log_says_whether_the_computer_may_sleep(inhibit, caplog, refused, level):
    inhibit(refused)
    with caplog.at_level(logging.INFO), kept_awake("left, right"):
        deadline = time.monotonic() + 5.0
        while not caplog.records and time.monotonic() < deadline:
            time.sleep(0.01)
    (record,) = caplog.records
    assert record.levelno == level and record.message.startswith("left, right: ")
    assert ("mask sleep.target" in record.message) == (level == logging.WARNING)


def test_arms_are_driven_even_where_no_process_can_be_started(inhibit, monkeypatch, caplog):
    inhibit()
    monkeypatch.setenv("PATH", "/nowhere")
    with kept_awake("left"):
        assert "left: nothing keeps this computer from going to sleep" in caplog.text


def test_real_arms_keep_the_computer_awake_and_virtual_ones_do_not(inhibit, rig):
    log = inhibit()
    with pytest.raises(BusError, match="can_nowhere"):
        ArmSession([ArmConfig(channel="can_nowhere", interface="socketcan")], isolation="thread").start()
    await_end(log)
    log.unlink()
    arm = ArmConfig(
        channel="follower_left",
        interface="yam_sim",
        can_options={"rig": rig.name},
        gripper_stops_rad=[3.25, -3.3],
    )
    session = ArmSession([arm], isolation="thread")
    session.start()
    session.stop()
    assert not lines(log)


def test_a_computer_that_cannot_sleep_needs_no_lock(inhibit, tmp_path, caplog):
    log = inhibit()
    assert can_sleep()
    (tmp_path / "suspend.target").symlink_to("/dev/null")
    assert not can_sleep()
    (tmp_path / "suspend.target").unlink()
    (tmp_path / "state").write_text("\n")
    assert not can_sleep()
    (tmp_path / "state").unlink()
    with kept_awake("left"):
        pass
    assert not lines(log) and not caplog.records
