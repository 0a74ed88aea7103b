"""Lifts and returns by a hand that trembles, on the rig: the gate misses, doubles and hurries no transition."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.state.modes import Gate
from tests.support.coupled import FOLLOWER, LEADER, Passing, coupled_session
from tests.support.gate_reference import Ticks, check_gates
from tests.support.rigged import lockstep_rig

rig = lockstep_rig(LEADER, FOLLOWER)
TREMBLES_RAD = 0.003
SPEED_RAD_S = 1.5
LEAD = {"gate": "auto", "bilateral": 0.15, "approach_speed_rad_s": 1.5, "homing_speed_rad_s": 1.0}


class Hand:
    """Moves the leader of a pair, and keeps what both arms did at each tick.

    Attributes:
        seen: of each tick: stamp of the follower; gate, both arms' true joints, target and set-point, see `Ticks`.
    """

    def __init__(self, rig, session, rng):
        self._rig, self._session, self._rng, self._caller = rig, session, rng, Passing(session)
        self._addresses = [rig.device.world.joint_addresses(channel) for channel in (LEADER, FOLLOWER)]
        self.seen = []

    def rest(self, seconds):
        self._caller.run(seconds, self._note)

    def _note(self):
        leader, follower = self._session[LEADER].newest(), self._session[FOLLOWER].newest()
        true = [[self._rig.device.world.qpos[at] for at in addresses] for addresses in self._addresses]
        self.seen.append((follower.published_s, leader.gate, *true, leader.action[:6], follower.setpoint_q))

    def go(self, q, seconds, stays_s=0.0):
        """Bring the leader to q (6,), trembling, and keep it there."""
        start = np.array(self._rig.state()["arms"][LEADER]["q"])
        times = np.arange(0.02, seconds + stays_s + 0.02, 0.02)
        share = 0.5 - 0.5 * np.cos(np.pi * np.minimum(times / seconds, 1.0))[:, None]
        path = start + share * (np.array(q) - start) + self._rng.normal(0.0, TREMBLES_RAD, (len(times), 6))
        self._rig.hand(LEADER, times.tolist(), path.tolist(), gives_way=False)
        self.rest(seconds + stays_s)

    def lift(self, least_s=1.4):
        """High enough to engage, and mostly for long enough to be caught up with."""
        q = self._rng.uniform([-0.3, 0.6, 0.3, -0.4, -0.3, -0.3], [0.3, 0.9, 0.9, 0.4, 0.3, 0.3])
        self.go(q, self._rng.uniform(0.4, 0.8), self._rng.uniform(0.2, 1.0) * least_s)

    def lower(self, stays_s, most_rad=0.25):
        q = self._rng.uniform([-0.1, 0.0, 0.0, -0.1, -0.1, -0.1], [0.1, most_rad, 0.2, 0.1, 0.1, 0.1])
        self.go(q, self._rng.uniform(0.4, 0.8), stays_s)


def lift_and_return(rig, hand, rng):
    """One lift and one return; on the way it may hesitate, dip for too short a time, or rise again while homing."""
    hand.lift()
    if rng.random() < 0.4:
        hand.go([0.0, rng.uniform(0.2, 0.45), 0.2, 0.0, 0.0, 0.0], 0.3, rng.uniform(0.0, 0.3))
        hand.lift(0.5)
    hand.lower(rng.uniform(0.5, 1.2))
    while rng.random() < 0.4:
        hand.go([0.0, rng.uniform(0.3, 0.8), 0.4, 0.0, 0.0, 0.0], rng.uniform(0.2, 0.5), rng.uniform(0.0, 1.0))
        hand.lower(rng.uniform(0.5, 1.2))
    if rng.random() < 0.5:
        rig.release(LEADER)  # it is led home
        hand.rest(rng.uniform(0.5, 1.5))


@pytest.mark.long
@pytest.mark.parametrize(("seed", "lifts"), [(0, 1), *((seed, 5) for seed in range(1, 41))])
def test_lifts_and_returns_miss_double_and_hurry_no_transition(rig, seed, lifts):
    rng = np.random.default_rng(seed)
    session = coupled_session(rig, **LEAD)
    session.start()
    hand = Hand(rig, session, rng)
    hand.rest(1.0)
    hand.seen.clear()
    for _ in range(lifts):
        lift_and_return(rig, hand, rng)
    session.discard()
    stamps, gates, *poses = zip(*hand.seen, strict=True)
    ticks = Ticks(list(gates), *map(np.array, poses))
    passed = check_gates(LeadConfig(follower=FOLLOWER, **LEAD), ticks)
    assert passed.count(Gate.APPROACH) >= lifts
    steps = np.abs(np.diff(ticks.setpoint, axis=0)).max(axis=1)
    assert (steps <= SPEED_RAD_S * np.diff(stamps) * 1.001 + 1e-9).all()
