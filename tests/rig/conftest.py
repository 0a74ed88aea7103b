"""One rig for the tests of a module that do not need it fresh, and a desk without friction for each test."""

import contextlib

import pytest

from lerobot_robot_yam.rig.control import running_rig
from tests.support.rig_desk import Desk


@pytest.fixture(scope="module")
def rig():
    with running_rig() as rig:
        yield rig


@pytest.fixture
def desk():
    with contextlib.closing(Desk(friction=0)) as desk:
        yield desk
