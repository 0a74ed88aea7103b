"""The force at a leader: what a hand feels, what an arm without a hand does, and that nothing ever grows."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.laws.bilateral import BilateralForce
from lerobot_robot_yam.control.laws.set_point import SetPoint
from lerobot_robot_yam.control.teleop.lead import MotionFilter

STEP_S, TICK_S = 0.001, 0.004
_Q_STEP = 25.0 / 65535
_DQ_STEP = np.array([20.0] * 3 + [60.0] * 3) / 4095
_AHEAD_S = 0.0033
GRIP_M = 0.05  # radius at which fingers hold a handle: by that they resist turning


class _Arm:
    """M ddq = K (q* − q) + D (dq* − dq) + tau, (6,), about a pose."""

    def __init__(self, model, q, extra_mass_kg=0.0):
        profile = load_arm("yam")
        data = mujoco.MjData(model)
        data.qpos[:6] = q
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        self.jacobian = np.zeros((3, model.nv))
        self.turning = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, self.jacobian, self.turning, model.site("tcp_site").id)
        self.jacobian, self.turning = self.jacobian[:, :6], self.turning[:, :6]
        self.inertia = full[:6, :6] + np.diag(profile.armature_kg_m2)
        self.inertia += extra_mass_kg * self.jacobian.T @ self.jacobian
        self.q, self.dq = np.zeros(6), np.zeros(6)  # from the pose

    def step(self, stiffness, damping, pull):
        """Implicit, so that a stiff hand is no matter; pull: (6,) K q* + D dq* + tau."""
        left = self.inertia + STEP_S * damping + STEP_S**2 * stiffness
        self.dq = np.linalg.solve(left, self.inertia @ self.dq + STEP_S * (pull - stiffness @ self.q))
        self.q = self.q + STEP_S * self.dq

    def read(self):
        return np.round(self.q / _Q_STEP) * _Q_STEP, np.round(self.dq / _DQ_STEP) * _DQ_STEP


class HeldLeader:
    """A leader in a hand, and its follower, linearised about a pose: laws and filters of both loops, in ms steps.

    The hand is a mass at the leader's tool on a damped spring. Links do not rub, so that only the laws can bring them
    to rest. Readings have the steps of the motors' frames. What a loop publishes the other one uses a tick later, and
    a command acts a tick after the sample that it is made of.

    Args:
        q: (6,) the pose, rad.
        gain: of the force.
        stiffness_n_m, mass_kg, damping_ratio: of the hand.
        gated: see `BilateralForce`.
        sag_nm: (6,) torque that pulls the follower off its set-point.
        blocked: the follower cannot move.

    Attributes:
        energies_j: one for each tick.
    """

    def __init__(self, q, gain, stiffness_n_m, mass_kg, damping_ratio, gated=True, sag_nm=None, blocked=False):
        profile = load_arm("yam")
        self.leader = _Arm(GravityModel("yam", "yam_teaching_handle").model, q, mass_kg)
        self.follower = _Arm(GravityModel("yam", "linear_4310").model, q)
        self._kp, self._kd = np.array(profile.kp), np.array(profile.kd)
        self._idle = np.array(profile.idle_kd)
        jacobian = self.leader.jacobian
        grip = jacobian.T @ jacobian + GRIP_M**2 * self.leader.turning.T @ self.leader.turning
        self._hand = stiffness_n_m * grip
        self._hand_damping = 2.0 * damping_ratio * np.sqrt(stiffness_n_m * mass_kg) * grip
        self._force = BilateralForce(np.full(6, gain), self._kp, np.array(profile.torque_limit_nm), gated)
        wide = np.full(6, 10.0)
        self._setpoint = SetPoint(np.full(6, 1.5), np.full(6, 30.0), -wide, wide, np.full(6, 5.0))
        self._motion = MotionFilter(6)
        self.sag, self._blocked = np.zeros(6) if sag_nm is None else sag_nm, blocked
        self.tau = np.zeros(6)
        self.hand_pull = np.zeros(6)
        self._next = np.zeros(6)
        self._asked = np.zeros((2, 6)), np.zeros(6)
        self._published = np.zeros(6), np.zeros(6), 0.0
        self._seen = np.zeros(6), np.zeros(6), 0.0
        self.now = 0.0
        self.energies_j = []

    @property
    def energy_j(self):
        """Of the leader in its hand, and of the spring that pulls it to its follower."""
        q, dq, error = self.leader.q, self.leader.dq, self.follower.q - self.leader.q
        return 0.5 * (dq @ self.leader.inertia @ dq + q @ self._hand @ q + self._force.stiffness @ error**2)

    def run(self, seconds):
        """(k, 6) speeds of the leader, (k, 6) its positions, and torques on it, one row per tick."""
        rows = []
        for _ in range(round(seconds / TICK_S)):
            self._tick()
            for _ in range(round(TICK_S / STEP_S)):
                self._step()
            self.energies_j.append(self.energy_j)
            rows.append((self.leader.dq.copy(), self.leader.q.copy(), self.tau.copy()))
        return tuple(np.array(column) for column in zip(*rows, strict=True))

    def _tick(self):
        now = self.now
        action, rate, stamp_s = self._published  # of the leader, a tick ago
        self._setpoint.track(action + rate * (now - stamp_s + _AHEAD_S), rate, now)
        self._setpoint.step(now, TICK_S)
        self._asked = self._setpoint.asked, self._setpoint.asked_ddq
        q, dq = self.leader.read()
        self._motion.advance(q, dq, now)
        there, there_dq, seen_s = self._seen
        error = there + there_dq * (now - seen_s) - self._motion.q
        self._next = self._force.torque(error, self._motion.dq, np.zeros(6), TICK_S)
        self._published = self._motion.q, self._motion.dq, now
        self._seen = (*self.follower.read(), now)

    def _step(self):
        damping = self._hand_damping + np.diag(self._idle + self._force.damping)
        self.leader.step(self._hand, damping, self.tau + self.hand_pull)
        if not self._blocked:
            (q, dq), ddq = self._asked
            feed_forward = self.follower.inertia @ ddq
            pull = self._kp * q + self._kd * dq + feed_forward + self.sag
            self.follower.step(np.diag(self._kp), np.diag(self._kd), pull)
        self.now += STEP_S
        if round(self.now / STEP_S) % round(TICK_S / STEP_S) == 2:  # the command of this tick arrives
            self.tau = self._next


POSE = np.array([0.0, 1.0, 1.0, -0.3, 0.0, 0.0])
SAG_NM = np.array([0.0, 2.0, 1.0, 0.2, 0.0, 0.0])
KP = np.array(load_arm("yam").kp)
LIMIT_NM = np.array(load_arm("yam").torque_limit_nm)
STEADY = 0.02  # rad/s: what the steps of readings make of an arm at rest


def force(gain=0.5):
    return BilateralForce(np.full(6, gain), KP, LIMIT_NM)


def test_no_gain_is_no_force():
    law = force(0.0)
    assert not law.works and not law.damping.any()
    assert not law.torque(np.full(6, 0.2), np.ones(6), np.zeros(6), TICK_S).any()


@pytest.mark.parametrize("weight_nm", [0.0, 8.0])
def test_engaging_is_gentle_and_never_yanks(weight_nm):
    law = force()
    law.engage()
    weight, taus = np.full(6, weight_nm), []
    for _ in range(1250):  # 5 s
        taus.append(law.torque(np.full(6, 0.5), np.zeros(6), weight, TICK_S))
    taus = np.abs(taus)
    assert taus[:125].max() <= max(1.0, 0.5 * weight_nm) + 1e-9
    assert taus[0].max() == 0.0 and np.diff(taus, axis=0).max() < 0.05
    assert taus[-1] == pytest.approx(np.minimum(0.5 * KP * 0.5, 0.25 * LIMIT_NM))


def test_the_force_is_bounded_well_within_the_torque_limits():
    law = force()
    for _ in range(2000):
        tau = law.torque(np.full(6, 3.0), np.zeros(6), np.zeros(6), TICK_S)
    assert (np.abs(tau) <= 0.25 * LIMIT_NM).all()


def test_a_hand_that_holds_still_feels_a_push_on_the_follower_all_the_time():
    pair = HeldLeader(POSE, 0.2, 2000.0, 1.0, 0.5)
    pair.run(0.8)
    pair.sag = SAG_NM
    _, _, tau = pair.run(3.0)
    assert tau[-1, 1] == pytest.approx(0.2 * SAG_NM[1], rel=0.05)


def test_a_push_is_felt_within_two_ticks_of_the_follower_moving():
    """A tenth of what it will be, when the follower has moved by 1 mrad or by a tenth, whichever is more."""
    pair = HeldLeader(POSE, 0.2, 2000.0, 1.0, 0.5)
    pair.run(0.8)
    pair.sag = SAG_NM
    moved, tau = [], []
    for _ in range(250):
        _, _, torque = pair.run(TICK_S)
        moved.append(pair.follower.q[1])
        tau.append(torque[-1, 1])
    first = int(np.argmax(np.abs(moved) > max(1e-3, 0.1 * np.abs(moved[-1]))))
    assert tau[first + 2] > 0.1 * tau[-1]


@pytest.mark.parametrize("gain", [0.2, 0.5])
def test_a_leader_let_go_comes_to_rest_where_an_ungated_one_wanders_off(gain):
    gated, plain = (HeldLeader(POSE, gain, 0.0, 0.1, 0.5, gated=gated, sag_nm=SAG_NM) for gated in (True, False))
    speeds, way, _ = gated.run(6.0)
    assert np.abs(speeds[-100:]).max() < STEADY
    assert np.abs(way[-1]).max() < 0.5
    speeds, way, _ = plain.run(4.0)
    assert np.abs(speeds[-100:]).max() > 1.0 and np.abs(way[-1]).max() > 3.0


def let_go_at_a_wall(pose, gated, side):
    """(6,) largest speeds and ways of a leader let go 80 mrad inside a wall, and Nm before; joints rub with 0.1 Nm."""
    pair = HeldLeader(pose, 0.2, 0.0, 0.0, 0.5, gated=gated)
    start, follower, rows = 0.08 * side, pair.follower, []
    for tick in range(600):
        held = tick < 250  # the bound of the force grows for 1 s
        if held:
            pair.leader.q, pair.leader.dq = start.copy(), np.zeros(6)
        inside = follower.q * side > 0.0
        follower.q[inside] = follower.dq[inside] = 0.0
        pair.hand_pull = -0.1 * np.tanh(pair.leader.dq / 0.05)
        speeds, ways, taus = pair.run(TICK_S)
        if held:
            felt = np.abs(taus[-1])
        else:
            rows.append((speeds[-1], ways[-1] - start))
    return *np.abs(rows).max(axis=0), felt


@pytest.mark.parametrize("side", [np.ones(6), np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])])
def test_a_leader_let_go_at_a_wall_does_not_snap(side):
    speeds, ways, felt = let_go_at_a_wall(POSE, True, side)
    assert speeds.max() < 1.5 and ways.max() < 0.1
    plain_speeds, plain_ways, plain_felt = let_go_at_a_wall(POSE, False, side)
    assert plain_speeds.max() > 0.5 and plain_ways.max() > 0.15, "the plain spring is meant to throw it"
    assert felt == pytest.approx(plain_felt, rel=0.02)  # the stiffness is that of the plain spring
    assert felt[:3] == pytest.approx(0.2 * KP[:3] * 0.08, rel=0.02)


def decays(seed):
    """A pair about a random pose, in a random hand, is jolted; the largest energy, J, by windows of 0.4 s.

    Speeds of joints pass from one to the other, and a spring gives back what it has taken: only energy tells growth.
    """
    rng = np.random.default_rng(seed)
    low, high = load_arm("yam").joint_limits_rad.T
    stiffness = 0.0 if rng.random() < 0.2 else rng.uniform(0.0, 2000.0)
    mass_kg = float(np.exp(rng.uniform(np.log(0.1), np.log(2.0))))
    gain = rng.choice([0.0, 0.1, 0.2, 0.35, 0.5])
    pair = HeldLeader(
        rng.uniform(low, high), gain, stiffness, mass_kg, rng.uniform(0.05, 1.0), blocked=rng.random() < 0.3
    )
    pair.run(0.6)  # until the force has faded in
    pair.leader.dq = rng.uniform(-0.5, 0.5, 6)
    pair.run(2.4)
    return np.array(pair.energies_j[-600:]).reshape(6, -1).max(axis=1)


def check_decays(seed):
    """An arm of which nothing but its joints' own damping takes energy away keeps three quarters of it in 2 s."""
    windows = decays(seed)
    assert (windows[1:] < windows[:-1] + 1e-3 * windows[0]).all(), windows  # the steps of readings move an arm at rest
    assert windows[-1] < 0.8 * windows[0], windows


@pytest.mark.parametrize("seed", range(8))
def test_a_jolt_decays(seed):
    check_decays(seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8, 200))
def test_a_jolt_decays_in_any_hand_and_pose(seed):
    check_decays(seed)


def test_unused_credit_decays():
    """A leader that was moved against the force may come back as far; seconds later, only a part of that way."""

    def way_until_gone(rest_s):
        force = BilateralForce(np.full(1, 0.2), np.full(1, 80.0), np.full(1, 20.0))

        def run(rad_s, seconds):
            last = 0.0
            for _ in range(round(seconds / TICK_S)):
                last = force.torque(np.full(1, 0.05), np.full(1, rad_s), np.zeros(1), TICK_S)[0]
            return last

        run(0.0, 5.0)  # the bound has grown
        run(-1.0, 0.5)  # more than the maximum credit
        run(0.0, rest_s)
        way = 0.0
        while run(1.0, TICK_S) > 0.0:
            way += TICK_S
        return way

    assert way_until_gone(0.0) - way_until_gone(4.0) == pytest.approx(0.3 * (1.0 - np.exp(-2.0)), abs=0.02)
