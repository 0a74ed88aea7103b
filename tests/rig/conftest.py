"""One rig for the tests of a module that do not need it fresh."""

import pytest

from lerobot_robot_yam.rig.control import running_rig


@pytest.fixture(scope="module")
def rig():
    with running_rig() as rig:
        yield rig
