"""One rig for the tests of a module that do not need it fresh, and a bus on it or a desk for each test."""

import contextlib

import can
import pytest

from lerobot_robot_yam.rig.control import running_rig
from tests.support.rig_desk import Desk


@pytest.fixture(scope="module")
def rig():
    with running_rig() as rig:
        yield rig


@pytest.fixture
def bus(rig):
    with can.Bus(interface="yam_sim", channel="follower_left", rig=rig.name) as bus:
        yield bus


@pytest.fixture
def desk():
    with contextlib.closing(Desk(friction=0)) as desk:
        yield desk
