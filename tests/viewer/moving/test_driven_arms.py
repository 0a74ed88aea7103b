"""A recorded motion on its way, in lock-step: a motion that ends at speed ends where it says, whatever the pace."""

import numpy as np
import pytest

from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.viewer.moving.driven_arms import Replay
from tests.support.rigged import lockstep_rig, sim_config

ARM = "follower_left"
END = np.array([0.1, 0.7, 0.7, -0.2, 0.1, 0.1, 0.4])
rig = lockstep_rig(ARM)


@pytest.fixture
def session(rig):
    session = ArmSession([sim_config(rig, ARM, interface="yam_lockstep")], isolation="lockstep")
    session.start()
    yield session
    session.discard()


@pytest.mark.long
@pytest.mark.parametrize("steps_ms", [range(15, 27, 5), range(15, 27)])
def test_an_arm_that_arrives_at_speed_holds_at_the_end(session, steps_ms):
    client = session[ARM]
    rows = np.tile(END, (40, 1))
    rows[:, 0] += 0.3 * np.sin(np.linspace(0.0, np.pi, 40))
    missed = []
    for step_ms in steps_ms:
        replayed = Replay([client], Trajectory(np.arange(40) / 60.0, rows), session.clock.now())
        while not replayed.step(session.clock.now()):
            session.clock.sleep(step_ms / 1e3)
        client.hold()
        session.clock.sleep(0.5)
        missed.append(np.abs(np.array(client.observe().setpoints) - END).max())
    assert max(missed) < 1e-3
