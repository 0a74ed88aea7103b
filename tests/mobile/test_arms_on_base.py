"""Two arms that ride on a base: one session of all three, and whole episodes, in lock-step with the rig."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.rig.lockstep.demonstrator import Demonstrator
from lerobot_robot_yam.state.modes import Mode
from tests.support.rigged import lockstep_rig, session_on, sim_config

SIDES, TASK, PERIOD_S = ("left", "right"), "mobile_tables", 1.0 / 30.0
ARMS = tuple(f"follower_{side}" for side in SIDES)

rig = lockstep_rig(*ARMS, scene=TASK)


@contextlib.contextmanager
def running(rig):
    base = BaseConfig(channel="base", interface="yam_lockstep", can_options={"rig": rig.name})
    session = session_on(rig, *(sim_config(rig, arm) for arm in ARMS), base)
    session.start()
    try:
        yield session
    finally:
        session.discard()


def sites(rig):
    return np.array([rig.state()["arms"][arm]["tcp_site"]["pos"] for arm in ARMS])


@pytest.mark.long
def test_arms_ride_hold_and_do_not_tip_the_base(rig):
    body, tilts = rig.device.world.data.body("base"), []
    with running(rig) as session:
        floor, before = body.xpos[2], sites(rig)
        for twist in ([-0.5, 0.0, 0.0], [0.0, 0.0, 0.0]):  # at the default limit of acceleration, both ways
            for _ in range(60):
                session.base("base").write_velocity(twist)
                session.clock.sleep(0.05)
                tilts.append(body.xmat[8])
        assert [session[arm].mode() for arm in ARMS] == [Mode.HOLD, Mode.HOLD]
    gone = np.array(rig.state()["base"]["pose"][:2]) - [-0.35, 0.0]
    assert gone[0] < -1.0
    assert sites(rig)[:, :2] - before[:, :2] == pytest.approx(np.array([gone, gone]), abs=0.01)
    assert sites(rig)[:, 2] == pytest.approx(before[:, 2], abs=0.01)
    assert min(tilts) > np.cos(np.radians(0.5))
    assert body.xpos[2] == pytest.approx(floor, abs=2e-3)


def step(rig, session, row):
    for number, arm in enumerate(ARMS):
        *q, opening = row[7 * number : 7 * number + 7]
        session[arm].write_target(q, opening)
    session.base("base").write_velocity(row[14:])
    session.clock.sleep(PERIOD_S)
    return rig.task_state()


def demonstrated(rig):
    """Actions of one attempt, up to its success."""
    rows = []
    with running(rig) as session:
        rig.task(TASK, 4)
        with contextlib.closing(Demonstrator(rig, TASK, SIDES)) as operator:
            while not operator.done:
                targets = operator.targets()
                rows.append(np.concatenate([*(targets[side] for side in SIDES), operator.velocity]))
                if step(rig, session, rows[-1])["success"]:
                    return rows
    raise AssertionError(rig.task_state())


@pytest.mark.long
@pytest.mark.timeout(1800)  # both runs are of 20 s of simulated time; a busy machine needs ten times that
def test_the_operator_carries_the_block_and_so_does_a_replay_from_a_start_a_little_off(rig):
    rows = demonstrated(rig)
    rows += [np.append(rows[-1][:14], np.zeros(3))] * 30
    rig.restart()
    rig.device.world.data.joint("base").qpos[:2] += 0.004
    with running(rig) as session:
        rig.task(TASK, 4)
        states = [step(rig, session, row) for row in rows]
    assert states[-1]["success"], states[-1]
