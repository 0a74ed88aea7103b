"""Gated arms in lock-step: a hand lifts the leader and brings it back, the follower comes and goes home."""

import numpy as np
import pytest

from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Gate
from scripts import recorders
from tests.support.coupled import FOLLOWER, LEADER, Passing, coupled_session
from tests.support.rigged import lockstep_rig

rig = lockstep_rig(LEADER, FOLLOWER)
LIFTED = [0.2, 0.9, 0.8, -0.3, 0.1, -0.1]
HOME = [0.0] * 6
SPEED = 1.5


class Followed(Passing):
    """As `Passing`, and what the arms did at each tick.

    Attributes:
        gates: as they follow each other.
        setpoints: (time, (6,)) of the follower.
    """

    def __init__(self, session):
        super().__init__(session)
        self.gates, self.setpoints = [], []

    def note(self):
        state = self._session[LEADER].newest()
        if not self.gates or state.gate is not self.gates[-1]:
            self.gates.append(state.gate)
        follower = self._session[FOLLOWER].newest()
        if not self.setpoints or follower.published_s > self.setpoints[-1][0]:
            self.setpoints.append((follower.published_s, follower.setpoint_q))

    def run(self, seconds, each_tick=None):
        super().run(seconds, self.note)

    def fastest(self):
        times, q = np.array([t for t, _ in self.setpoints]), np.array([q for _, q in self.setpoints])
        return (np.abs(np.diff(q, axis=0)) / np.diff(times)[:, None]).max()


@pytest.fixture
def started(rig):
    """Starts both arms with these options of a leader; returns session and caller."""
    sessions = []

    def start(**lead):
        session = coupled_session(rig, **lead)
        session.start()
        sessions.append(session)
        return session, Followed(session)

    yield start
    for session in sessions:
        session.discard()


def pose(rig, channel):
    return np.array(rig.state()["arms"][channel]["q"])[:6]


@pytest.mark.long
def test_a_lift_a_return_and_a_second_lift_on_the_way_home(rig, started):
    session, arms = started(gate="auto")
    arms.run(2.0)
    assert arms.gates == [Gate.HOMING, Gate.IDLE]
    assert np.abs(pose(rig, FOLLOWER)).max() < 0.05 and np.abs(pose(rig, LEADER)).max() < 0.1
    rig.hand(LEADER, [1.0], [LIFTED])
    arms.run(3.5)
    assert arms.gates[2:] == [Gate.APPROACH, Gate.ENGAGED]
    assert np.abs(pose(rig, FOLLOWER) - pose(rig, LEADER)).max() < 0.02
    rig.hand(LEADER, [1.0], [[0.1, 0.2, 0.2, -0.1, 0.0, 0.0]])
    arms.run(1.6)
    assert arms.gates[4:] == [Gate.HOMING]
    rig.hand(LEADER, [0.5], [LIFTED])
    arms.run(3.0)
    assert arms.gates[5:] == [Gate.APPROACH, Gate.ENGAGED]
    rig.hand(LEADER, [1.0], [HOME])
    arms.run(4.0)
    assert arms.gates[7:] == [Gate.HOMING, Gate.IDLE]
    assert np.abs(pose(rig, FOLLOWER)).max() < 0.05
    assert arms.fastest() <= SPEED * 1.001


@pytest.mark.long
def test_after_an_emergency_stop_both_are_led_home(rig, started):
    session, arms = started(gate="auto")
    arms.run(1.0)
    rig.hand(LEADER, [1.0], [LIFTED])
    arms.run(3.0)
    assert arms.gates[-1] is Gate.ENGAGED
    rig.release(LEADER)
    stop = EmergencyStop()
    stop.latch("test")
    arms.run(0.5)
    at = pose(rig, LEADER)
    assert arms.gates[-1] is Gate.HOMING and np.abs(at - LIFTED).max() < 0.1
    stop.release()
    recorders.truth_start(rig, LEADER, 5.0)
    arms.run(4.0)
    assert arms.gates[-1] is Gate.IDLE
    assert np.abs(recorders.truth(rig, LEADER)["dq"]).max() < 0.8
    assert np.abs(pose(rig, LEADER)).max() < 0.1 and np.abs(pose(rig, FOLLOWER)).max() < 0.05


def test_nothing_moves_before_somebody_passes_the_action_on(rig, started):
    session, arms = started(gate="auto")
    for _ in range(60):
        session[FOLLOWER].write_target([-0.2, 0.6, 0.6, -0.3, 0.0, 0.0], 0.5)
        arms.stall(1 / 30, arms.note)
    arms.stall(1.0, arms.note)
    assert arms.gates == [Gate.HOMING]
    before = pose(rig, FOLLOWER)
    arms.stall(1.0, arms.note)
    assert np.abs(pose(rig, FOLLOWER) - before).max() < 0.005
    assert session[LEADER].newest().action == pytest.approx(session[FOLLOWER].newest().setpoints, abs=1e-3)
    arms.run(3.0)
    assert arms.gates == [Gate.HOMING, Gate.IDLE]


@pytest.mark.long
def test_a_button_engages_and_releases_and_the_follower_stays(rig, started):
    session, arms = started(gate="button", gate_button="top")
    rig.hand(LEADER, [1.5], [LIFTED])
    arms.run(2.0)
    assert arms.gates == [Gate.IDLE]
    assert np.abs(pose(rig, FOLLOWER) - pose(rig, LEADER)).max() > 0.5
    for expected in ([Gate.APPROACH, Gate.ENGAGED], [Gate.IDLE]):
        seen = len(arms.gates)
        rig.buttons(LEADER, sync=True)
        arms.run(0.2)
        rig.buttons(LEADER)
        arms.run(2.3)
        assert arms.gates[seen:] == expected
    at = pose(rig, FOLLOWER)
    rig.hand(LEADER, [1.0], [HOME])
    arms.run(1.5)
    assert np.abs(pose(rig, FOLLOWER) - at).max() < 0.02


@pytest.mark.long
def test_fine_mode_scales_and_recentres(rig, started):
    session, arms = started(gate="always", fine_button="bottom", fine_scale=0.25)
    rig.hand(LEADER, [1.5], [LIFTED])
    arms.run(3.0)
    assert arms.gates[-1] is Gate.ENGAGED
    rig.buttons(LEADER, record=True)
    arms.run(0.1)
    rig.buttons(LEADER)
    arms.run(0.2)
    assert arms.gates[-1] is Gate.FINE
    follower, leader = session[FOLLOWER].newest().setpoint_q, pose(rig, LEADER)
    rig.hand(LEADER, [1.0], [(np.array(LIFTED) + [0.2, 0.2, 0.2, 0.1, 0.1, 0.1]).tolist()])
    arms.run(1.5)
    moved = (session[FOLLOWER].newest().setpoint_q - follower) / (pose(rig, LEADER) - leader)
    assert moved == pytest.approx(0.25, abs=0.02)
    rig.release(LEADER)
    rig.buttons(LEADER, record=True)
    arms.run(0.1)
    rig.buttons(LEADER)
    arms.run(4.0)
    assert arms.gates[-3:] == [Gate.RECENTRE, Gate.APPROACH, Gate.ENGAGED]
    assert np.abs(pose(rig, FOLLOWER) - pose(rig, LEADER)).max() < 0.03


@pytest.mark.long
def test_an_approach_is_smooth_and_aims_at_the_live_leader(rig, started):
    session, arms = started(gate="auto")
    arms.run(1.5)
    rig.hand(LEADER, [0.8, 1.6], [LIFTED, [0.4, 1.1, 0.8, -0.4, 0.0, 0.0]])
    recorders.truth_start(rig, FOLLOWER, 5.0)
    arms.run(4.0)
    assert arms.gates[-1] is Gate.ENGAGED
    dq = recorders.truth(rig, FOLLOWER)["dq"][:, :6]
    assert np.abs(dq).max() < SPEED * 1.1
    assert np.abs(dq[10:] - dq[:-10]).max() < 0.4
    assert np.abs(pose(rig, FOLLOWER) - pose(rig, LEADER)).max() < 0.02
