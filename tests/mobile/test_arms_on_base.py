"""Two arms that ride on a base: one session of all three, in lock-step with the rig."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.modes import Mode

SIDES = ("left", "right")


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig("mobile_tables")) as rig:
        yield rig


@pytest.fixture
def session(rig):
    wire = {"interface": "yam_lockstep", "can_options": {"rig": rig.name}}
    stops = [3.251, -3.301]
    arms = [ArmConfig(name=s, channel=f"follower_{s}", gripper_stops_rad=stops, **wire) for s in SIDES]
    session = ArmSession([*arms, BaseConfig(name="base", channel="base", **wire)], "lockstep")
    session.start()
    yield session
    session.stop()


def sites(rig):
    return np.array([rig.state()["arms"][f"follower_{side}"]["tcp_site"]["pos"] for side in SIDES])


def test_arms_ride_hold_and_do_not_tip_the_base(rig, session):
    base, floor = session.base("base"), rig.device.world.data.body("base").xpos[2]
    before, tilts = sites(rig), []
    for twist in ([-0.5, 0.0, 0.0], [0.0, 0.0, 0.0]):  # at the default limit of acceleration, both ways
        for _ in range(60):
            base.write_velocity(twist)
            session.clock.sleep(0.05)
            tilts.append(rig.device.world.data.body("base").xmat[8])
    gone = np.array(rig.state()["base"]["pose"][:2]) - [-0.35, 0.0]
    assert gone[0] < -1.0
    assert sites(rig)[:, :2] - before[:, :2] == pytest.approx(np.array([gone, gone]), abs=0.01)
    assert sites(rig)[:, 2] == pytest.approx(before[:, 2], abs=0.01)
    assert min(tilts) > np.cos(np.radians(0.5))
    assert rig.device.world.data.body("base").xpos[2] == pytest.approx(floor, abs=2e-3)
    assert [session[side].mode() for side in SIDES] == [Mode.HOLD, Mode.HOLD]
