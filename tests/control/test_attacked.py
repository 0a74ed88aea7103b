"""Another program of the same user damages everything of a running session that it can find: the arm stays held."""

import contextlib
import fcntl
import os
import signal
import time
from pathlib import Path

import pytest

from lerobot_robot_yam.rig.control import runs
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.control.process.test_stand_by import control_pid, faults, last_event, stand_by_pid, start, stretch, wait_mode

pytestmark = pytest.mark.alone

CHANNEL = "follower_left"


def files_of(session):
    """Names in the runtime directory, but for the rig's own, which stand for the cables; then what is open."""
    for path in runtime_dir().iterdir():
        if path.name.startswith(("state-", "lock-", "command-", "emergency-stop")):
            yield path
    for pid in (os.getpid(), control_pid(session), stand_by_pid(session)):
        for path in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                target = os.readlink(path)
                ours = "yam" in target and not target.endswith("-stillness")  # which is the tests' own
                if ours and not target.startswith(("socket:", "pipe:")):
                    yield path


def overwrite(path):
    descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    try:
        for spoil in (
            lambda: os.pwrite(descriptor, b"\xff" * 4096, 0),
            lambda: os.ftruncate(descriptor, 0),
            lambda: fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_WRITE),
            lambda: os.fchmod(descriptor, 0),
        ):
            with contextlib.suppress(OSError):
                spoil()
    finally:
        os.close(descriptor)


def replace(path):
    path.unlink()
    path.mkdir()


def test_nothing_that_is_done_to_its_files_lets_an_arm_fall(rig):
    session = start(rig, CHANNEL)
    pids = (control_pid(session), stand_by_pid(session))
    try:
        stretch(session, 1.5, CHANNEL)
        since, before = last_event(rig), rig.state()["arms"][CHANNEL]["grasp_site"]["pos"][2]
        found = list(files_of(session))
        assert len([path for path in found if path.is_relative_to("/proc")]) >= 5  # blocks of three processes, a lock
        assert {path.name.split("-")[0] for path in found if not path.is_relative_to("/proc")} >= {"state", "lock"}
        for path in found:
            with contextlib.suppress(OSError):
                overwrite(path)
        for path in found:
            if not path.is_relative_to("/proc"):
                replace(path)
        deadline = time.monotonic() + 1.0
        while time.monotonic() < deadline:
            assert session[CHANNEL].observe().mode in (Mode.HOLD, Mode.TRACK)
            session[CHANNEL].write_target([0.1, 1.2, 1.2, -0.2, 0.0, 0.0], 0.5)  # and the caller drives on
            time.sleep(0.02)
        assert all(runs(pid) for pid in pids)
        assert rig.state()["arms"][CHANNEL]["q"][1] == pytest.approx(1.2, abs=0.02)
        assert abs(rig.state()["arms"][CHANNEL]["grasp_site"]["pos"][2] - before) < 0.1
        os.kill(pids[0], signal.SIGKILL)  # the stand-by does not need them either
        wait_mode(session[CHANNEL], Mode.LAND)
        wait_mode(session[CHANNEL], Mode.OFF, 15.0)
    finally:
        session.stop()
        for path in runtime_dir().iterdir():
            if path.is_dir() and path.name.startswith(("state-", "lock-")):
                path.rmdir()
    assert not faults(rig, since)
