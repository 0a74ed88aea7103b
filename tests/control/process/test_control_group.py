"""The stand-by leaves the control group of the others: what freezes those does not freeze it."""

import contextlib
import errno
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lerobot_robot_yam.control.process import stand_by
from lerobot_robot_yam.rig.client.rig_control import running_rig
from tests.control.process.test_stand_by import faults, last_event

CHANNEL = "follower_left"

CALLER = """
import sys, time
from tests.control.process import test_stand_by as t
from lerobot_robot_yam.rig.client.rig_control import RigControl
with RigControl(sys.argv[1]) as rig:
    session = t.start(rig, "follower_left")
    t.stretch(session, 1.5, "follower_left")
print("stretched", flush=True)
time.sleep(60)
"""


@contextlib.contextmanager
def group():
    """A control group within one of ours, as a delegated one would be."""
    if stand_by._BOOTED.exists():
        pytest.skip("systemd runs this machine and its control groups")
    try:
        ours = Path(stand_by._mount() + stand_by._group()) / f"yam-test-{os.getpid()}"
        (ours / "session").mkdir(parents=True)
    except OSError as error:
        pytest.skip(f"no control group can be made here: {error}")
    try:
        yield ours / "session"
    finally:
        for path in (*ours.iterdir(), ours):
            if path.is_dir():
                empty(path)
                remove(path)


def empty(path):
    (path / "cgroup.freeze").write_text("0")
    (path / "cgroup.kill").write_text("1")
    deadline = time.monotonic() + 5.0
    while (path / "cgroup.procs").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def remove(path):
    """The kernel keeps a group busy for a moment after its last process has left `cgroup.procs`."""
    deadline = time.monotonic() + 5.0
    while True:
        try:
            return path.rmdir()
        except OSError as error:
            if error.errno != errno.EBUSY or time.monotonic() > deadline:
                raise
        time.sleep(0.02)


def enabled(rig):
    return any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())


@pytest.mark.alone
def test_an_arm_lands_when_the_group_of_its_session_is_frozen():
    with running_rig(arms=[CHANNEL]) as rig, group() as session:
        join = f'echo $$ > {session}/cgroup.procs; exec "$@"'
        command = ["sh", "-c", join, "sh", sys.executable, "-c", CALLER, rig.name]
        caller = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert caller.stdout.readline() == "stretched\n"
            assert [path.name for path in session.parent.glob("yam-stand-by-*")]
            since, deadline = last_event(rig), time.monotonic() + 15.0
            (session / "cgroup.freeze").write_text("1")
            while enabled(rig):
                assert time.monotonic() < deadline
                time.sleep(0.05)
            assert not faults(rig, since)
        finally:
            empty(session)
            caller.communicate()


def leave_group_in_a_child():
    module = "lerobot_robot_yam.control.process"
    code = f"from {module} import stand_by as g; print(g._group(), g.leave_group(), sep='\\n')"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()


def test_it_says_what_came_of_it():
    before, said = leave_group_in_a_child()
    if before in ("", "/"):
        assert said == "is in no control group but the machine's, or its container's"
    else:
        assert said.startswith(("has a control group of its own", "shares its control group with the control process"))


def test_a_group_that_cannot_be_made_is_said(monkeypatch, tmp_path):
    (tmp_path / "cgroup").write_text("0::/somebody.slice/session-3.scope\n")
    monkeypatch.setattr(stand_by, "_GROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(stand_by, "_BOOTED", tmp_path / "none")
    said = stand_by.leave_group()
    assert said.startswith("shares its control group with the control process") and "somebody.slice" in said


ANSWERS = {"refuses": "echo no >&2; exit 1", "moves nobody": "exit 0", "moves": 'echo "0::/own.scope" > "$GROUPS_FILE"'}


@pytest.mark.parametrize("busctl", ANSWERS)
def test_systemd_is_asked_where_it_runs_the_machine(monkeypatch, tmp_path, busctl):
    """Its client is a script here, that writes down what it is asked."""
    groups, asked = tmp_path / "cgroup", tmp_path / "asked"
    groups.write_text(f"0::/user.slice/user@{os.getuid()}.service/app.slice/terminal.scope\n")
    script = tmp_path / "busctl"
    script.write_text(f'#!/bin/sh\necho "$@" > {asked}\n{ANSWERS[busctl]}\n')
    script.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("GROUPS_FILE", str(groups))
    monkeypatch.setattr(stand_by, "_GROUPS", groups)
    monkeypatch.setattr(stand_by, "_BOOTED", tmp_path)
    monkeypatch.setattr(stand_by, "_MOVED_S", 0.1)
    said = stand_by.leave_group()
    scope = f"StartTransientUnit ssa(sv)a(sa(sv)) yam-stand-by-{os.getpid()}.scope fail 2 "
    assert scope in asked.read_text() and asked.read_text().endswith(f"PIDs au 1 {os.getpid()} 0\n")
    assert said.startswith(
        "has a control" if busctl == "moves" else "shares its control group with the control process"
    )
    assert {"refuses": "systemd refuses: no", "moves nobody": "has not moved it", "moves": "/own.scope"}[busctl] in said
