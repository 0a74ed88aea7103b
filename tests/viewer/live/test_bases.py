"""A base that runs is drawn where its odometry has it, its state is told, and its end removes it."""

import time

import pytest
import viser

from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.viewer.live.bases import Bases, describe


@pytest.fixture
def server():
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


def test_a_base_is_drawn_and_told_and_removed(server):
    bases = Bases(server)
    with running_rig(scene="mobile") as rig:
        with YamBase(channel="base", interface="yam_sim", can_options={"rig": rig.name}) as base:
            for _ in range(40):
                base.set_target_velocity([0.3, 0.0, 0.3])
                time.sleep(0.05)
            bases.update(time.monotonic(), True)
            (shown,) = bases._shown.values()
            x, y, heading = base.odometry().pose
            assert shown._box.position[:2] == pytest.approx((x, y), abs=0.05) and x > 0.1 and heading > 0.1
            assert "TRACK" in shown._text.content or "HOLD" in shown._text.content
            assert "odometry" in describe(base.observe()) and not bases.warnings(time.monotonic())
            assert "silent" in bases.warnings(time.monotonic() + 1.0)[0]
        bases.update(time.monotonic() + 1.0, True)
        assert not bases._shown
    bases.close()
