import contextlib
import os
import pty

import pytest

from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from tests.support.crooked_arm import OFFSETS, scene


@pytest.fixture
def crooked(tmp_path):
    """A rig with one arm that lies at rest, whose motors' zeros are off by OFFSETS; joint 4 hangs at -0.17."""
    with contextlib.closing(LockstepRig(scene(tmp_path, [*OFFSETS, 0.0]))) as rig:
        yield rig


@pytest.fixture
def arm(tmp_path):
    """A rig in lock-step with one arm at rest."""
    with contextlib.closing(LockstepRig(scene(tmp_path, [0.0] * 7))) as rig:
        yield rig


@pytest.fixture(scope="module")
def live_arm(tmp_path_factory):
    """A live rig with one arm at rest, for commands that run in a process of their own."""
    with running_rig(scene=scene(tmp_path_factory.mktemp("live"), [0.0] * 7)) as rig:
        yield rig


@pytest.fixture
def state_home(tmp_path, monkeypatch):
    """Where the registers of motors are kept while they are changed."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "yam-motors"


@pytest.fixture
def type_in(monkeypatch):
    """Makes standard input a terminal at which this is typed; returns the end at which more can be."""
    with contextlib.ExitStack() as opened:

        def typed(text=b""):
            ours, theirs = pty.openpty()
            opened.callback(os.close, ours)
            monkeypatch.setattr("sys.stdin", opened.enter_context(os.fdopen(theirs)))
            os.write(ours, text)
            return ours

        yield typed
