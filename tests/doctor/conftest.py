"""Virtual rigs for the doctor."""

import pytest

from lerobot_robot_yam.rig.control import running_rig
from tests.support.doctor_desk import FOLLOWER, LEADER


@pytest.fixture(scope="module")
def rig():
    with running_rig(arms=[FOLLOWER, LEADER]) as rig:
        yield rig


@pytest.fixture
def sick():
    """A rig of this test alone, to make ill."""
    with running_rig(arms=[FOLLOWER, LEADER]) as rig:
        yield rig
