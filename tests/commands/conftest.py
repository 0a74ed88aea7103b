import pytest

from lerobot_robot_yam.rig.control import running_rig
from tests.support.crooked_arm import OFFSETS, scene


@pytest.fixture
def crooked(tmp_path):
    """A rig with one arm that lies at rest, whose motors' zeros are off by OFFSETS; joint 4 hangs at -0.17."""
    with running_rig(scene=scene(tmp_path, [*OFFSETS, 0.0])) as rig:
        yield rig


@pytest.fixture
def arm(tmp_path):
    """A rig with one arm at rest."""
    with running_rig(scene=scene(tmp_path, [0.0] * 7)) as rig:
        yield rig


@pytest.fixture
def state_home(tmp_path, monkeypatch):
    """Where the registers of motors are kept while they are changed."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "yam-motors"
