"""A virtual rig for the doctor."""

import pytest

from lerobot_robot_yam.rig.control import running_rig
from tests.support.doctor_desk import FOLLOWER, LEADER


@pytest.fixture(scope="module")
def rig():
    with running_rig(arms=[FOLLOWER, LEADER]) as rig:
        yield rig
