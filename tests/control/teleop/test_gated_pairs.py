"""Two leaders behind one gate on the virtual rig: what one of them does alone moves nothing."""

import numpy as np
import pytest

from lerobot_robot_yam.state.modes import Gate
from tests.support.coupled import BOTH, Passing, coupled_session
from tests.support.rigged import lockstep_rig

LEADERS, FOLLOWERS = zip(*BOTH, strict=True)
LIFTED = [0.1, 0.9, 0.8, -0.3, 0.1, -0.1]
HOME = [0.0] * 6
SPEED = 1.5

rig = lockstep_rig(*LEADERS, *FOLLOWERS)


class Gates(Passing):
    """As `Passing`, for both pairs.

    Attributes:
        gates: of each leader, as they follow each other.
        setpoints: of each tick, stamp and (2, 6) of the followers.
    """

    def __init__(self, session):
        super().__init__(session, pairs=BOTH)
        self.gates, self.setpoints = ([], []), []

    def note(self):
        for seen, leader in zip(self.gates, LEADERS, strict=True):
            gate = self._session[leader].published().gate
            if not seen or gate is not seen[-1]:
                seen.append(gate)
        states = [self._session[follower].published() for follower in FOLLOWERS]
        self.setpoints.append((states[0].published_s, [state.setpoint_q for state in states]))

    def run(self, seconds, each_tick=None):
        super().run(seconds, self.note)


@pytest.fixture
def arms(rig):
    session = coupled_session(rig, pairs=BOTH, gate="auto", together=True, bilateral=0.15)
    session.start()
    arms = Gates(session)
    arms.run(2.0)
    assert arms.gates == ([Gate.HOMING, Gate.IDLE],) * 2
    yield arms
    session.discard()


def poses(rig, channels):
    state = rig.state()["arms"]
    return np.array([state[channel]["q"][:6] for channel in channels])


def seen(arms, before=0):
    assert arms.gates[0] == arms.gates[1]
    return arms.gates[0][before:]


@pytest.mark.long
def test_both_gates_move_together(rig, arms):
    home = poses(rig, FOLLOWERS)
    rig.lift(LEADERS[0], LIFTED, 1.0)
    arms.run(1.5)
    assert seen(arms) == [Gate.HOMING, Gate.IDLE]  # one alone engages nothing
    assert np.abs(poses(rig, FOLLOWERS) - home).max() < 0.01
    rig.lift(LEADERS[1], LIFTED, 1.0)
    arms.run(3.0)
    assert seen(arms, 2) == [Gate.APPROACH, Gate.ENGAGED]
    assert np.abs(poses(rig, FOLLOWERS) - poses(rig, LEADERS)).max() < 0.03
    rig.bring_home(LEADERS[1])
    arms.run(2.5)
    assert seen(arms, 4) == []  # one alone releases nothing, and its follower goes along
    assert np.abs(poses(rig, FOLLOWERS) - poses(rig, LEADERS)).max() < 0.05
    rig.bring_home(LEADERS[0])
    arms.run(4.5)
    assert seen(arms, 4) == [Gate.HOMING, Gate.IDLE]
    assert np.abs(poses(rig, FOLLOWERS)).max() < 0.05
    times, setpoints = (np.array(column) for column in zip(*arms.setpoints, strict=True))
    moved = np.abs(np.diff(setpoints, axis=0)).max(axis=(1, 2))
    assert (moved <= SPEED * np.diff(times) * 1.001 + 1e-9).all()


def test_one_alone_engages_nothing(rig, arms):
    home = poses(rig, FOLLOWERS)
    rig.lift(LEADERS[0], LIFTED, 0.5)
    arms.run(0.8)
    assert seen(arms) == [Gate.HOMING, Gate.IDLE]
    assert np.abs(poses(rig, FOLLOWERS) - home).max() < 0.01
    rig.lift(LEADERS[1], LIFTED, 0.5)
    arms.run(0.8)
    assert seen(arms, 2) == [Gate.APPROACH]


@pytest.mark.long
def test_both_have_to_be_lifted_to_break_off_the_way_home(rig, arms):
    for leader in LEADERS:
        rig.lift(leader, LIFTED, 1.0)
    arms.run(3.0)
    assert seen(arms, 2) == [Gate.APPROACH, Gate.ENGAGED]
    for leader in LEADERS:
        rig.lift(leader, [0.1, 0.2, 0.2, -0.1, 0.0, 0.0], 0.8)
    arms.run(1.6)
    assert seen(arms, 4) == [Gate.HOMING]
    rig.lift(LEADERS[0], LIFTED, 0.4)
    arms.run(0.6)
    assert seen(arms, 5) == []
    rig.lift(LEADERS[1], LIFTED, 0.4)
    arms.run(2.5)
    assert seen(arms, 5) == [Gate.APPROACH, Gate.ENGAGED]
