"""A base that runs is drawn with the arms on it, its state is told, and its end removes it."""

import contextlib
import time

import numpy as np
import pytest
import viser

from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.base_records import BASE_STATE_DTYPE, BaseState
from lerobot_robot_yam.viewer.live.bases import Bases, by_odometry, describe
from lerobot_robot_yam.viewer.live.live import Live
from lerobot_robot_yam.viewer.live.watched_rigs import WatchedRigs
from tests.support.rigged import sim_config


@pytest.fixture
def server():
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


def test_a_base_is_drawn_and_told_and_removed(server):
    bases, rigs = Bases(server), WatchedRigs(server.scene)

    def update(now_s):
        bases.look(now_s)
        bases.draw(now_s, True, rigs, ())

    with running_rig(scene="mobile") as rig:
        with YamBase(channel="base", interface="yam_sim", can_options={"rig": rig.name}) as base:
            for _ in range(40):
                base.set_target_velocity([0.3, 0.0, 0.3])
                time.sleep(0.05)
            update(time.monotonic())
            (shown,) = bases._shown.values()
            x, y, heading = base.odometry().pose
            assert shown._frame.position[:2] == pytest.approx((x, y), abs=0.05) and x > 0.1 and heading > 0.1
            assert "TRACK" in shown._text.content or "HOLD" in shown._text.content
            assert "odometry" in describe(base.observe()) and not bases.warnings(time.monotonic())
            assert "silent" in bases.warnings(time.monotonic() + 1.0)[0]
        update(time.monotonic() + 1.0)
        assert not bases._shown
    bases.close()


def state(x, y, heading, rail_m=None):
    record = np.zeros((), BASE_STATE_DTYPE)
    record["pose"], record["motors"] = (x, y, heading), 8 if rail_m is None else 9
    record["rail_m_per_rad"], record["q"][-1] = 0.01, 100.0 * (rail_m or 0.0)
    return BaseState(record)


def test_the_mount_rides_on_the_odometry_and_on_the_rail():
    (_, _), (low, _) = by_odometry(state(1.0, 2.0, np.pi / 2))
    (_, _), (high, turned) = by_odometry(state(1.0, 2.0, np.pi / 2, rail_m=0.4))
    assert low[:2] == pytest.approx([1.0, 2.1]) and high - low == pytest.approx([0.0, 0.0, 0.4])
    assert turned == pytest.approx([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    assert np.isfinite(by_odometry(state(0.0, 0.0, 0.0, rail_m=np.nan))[1][0]).all()


def test_arms_of_the_virtual_rig_are_drawn_on_the_base_that_carries_them(server):
    with running_rig(scene="mobile_tables") as rig, contextlib.closing(Live(server)) as live:
        config = BaseConfig(channel="base", interface="yam_sim", can_options={"rig": rig.name})
        session = ArmSession([sim_config(rig, "follower_left"), config])
        session.start()
        try:
            live.update(time.monotonic())
            key, base = session.key("follower_left"), session.base("base")
            before = live.place_of(key)[0]
            assert before == pytest.approx([-0.25, 0.25, 0.0], abs=0.01)
            until_s = time.monotonic() + 20.0
            while base.observe().pose[0] > -0.1:
                assert time.monotonic() < until_s
                base.write_velocity([-0.2, 0.0, 0.0])
                time.sleep(0.02)
            (shown,) = live._bases._shown.values()
            live.update(time.monotonic())
            while not shown._mount.visible:  # a state that is being written is drawn one round later
                assert time.monotonic() < until_s
                live.update(time.monotonic())
            assert live.place_of(key)[0] - before == pytest.approx([base.observe().pose[0], 0.0, 0.0], abs=0.05)
            assert shown._mount.position - live.place_of(key)[0] == pytest.approx([0.0, -0.25, 0.0], abs=0.01)
        finally:
            session.stop()
