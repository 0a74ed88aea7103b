"""An arm's seven motors on a desk, with a handle."""

import pytest

from lerobot_robot_yam.damiao.chain import MotorChain
from tests.support.desk_bus import SPECS, DeskBus


@pytest.fixture
def bus():
    with DeskBus(SPECS, handle=True) as desk:
        yield desk


@pytest.fixture
def chain(bus):
    return MotorChain(bus, SPECS, channel="desk")
