"""Virtual rigs are drawn where their arms are."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.viewer.live.placement import places
from lerobot_robot_yam.viewer.live.watched_rigs import WatchedRigs
from lerobot_robot_yam.viewer.serving.page import Page
from tests.viewer.live.test_rig_world import shown


class Watched:
    """What `places` asks of an arm."""

    def __init__(self, rig):
        self.hardware, self.rig = ResolvedArm(ArmConfig(channel="follower_left")), rig


@pytest.fixture
def rigs():
    with contextlib.closing(Page(port=0)) as page, contextlib.closing(WatchedRigs(page.server.scene)) as rigs:
        yield rigs


def test_a_rig_stands_with_its_arms_after_another_has_ended(rigs):
    def apart(names):
        """How far each rig is drawn from where its arm stands, less than the place of the arm on the rig, m."""
        assert rigs.keep(names) and not rigs.keep(names)
        arms = {name: Watched(name) for name in names}
        return {
            name: position - rigs._sceneries[name]._root.position - rigs.worlds[name].base("follower_left")[0]
            for name, (position, _) in places(arms, rigs.worlds, {}).items()
        }

    with shown("one"), shown("two"), shown("three"):
        for names in (["one", "two"], ["two"], ["two", "three"], ["one", "three"]):
            assert np.allclose(list(apart(names).values()), 0.0), names
