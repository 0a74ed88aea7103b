"""Soft wall and torque clip: bounded, continuous, stable behind the real frame and its delay."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.damiao.codec import decode_mit, encode_mit, pack_mit, ranges_of

ARM = load_arm("yam")
LOWER, UPPER = ARM.joint_limits_rad.T
N = ARM.joint_count
MIDDLE = (LOWER + UPPER) / 2


def floating(q, dq, tau=0.0):
    """Rows of an arm that floats at q (n,) with speed dq (n,), wall included; and how far it is beyond."""
    out = np.zeros((N, 5))
    mit_laws.float_free(out, q, ARM.idle_kd, np.full(N, tau))
    beyond = mit_laws.soft_wall(out, q, dq, LOWER, UPPER, ARM.kp, ARM.kd, ARM.torque_limit_nm)
    return out, beyond


def motor_torque(out, q, dq):
    """What the motors compute from rows `out`."""
    return (
        out[:, mit_laws.KP] * (out[:, mit_laws.Q] - q)
        + out[:, mit_laws.KD] * (out[:, mit_laws.DQ] - dq)
        + out[:, mit_laws.TAU]
    )


@pytest.mark.parametrize("edge, sign", [(LOWER, -1.0), (UPPER, 1.0)], ids=["lower", "upper"])
def test_the_wall_pushes_back_from_zero_at_the_limit_without_a_step_and_within_its_bound(edge, sign):
    for speed in (0.0, 1.0, -1.0, 6.0):
        depths = np.linspace(-0.05, 1.0, 2101)
        pushes = []
        for depth in depths:
            q, dq = edge + sign * depth, np.full(N, sign * speed)
            pushes.append(-sign * (motor_torque(floating(q, dq)[0], q, dq) + ARM.idle_kd * dq))  # towards the inside
        pushes = np.array(pushes)
        assert np.abs(pushes[depths <= 0.0]).max() < 1e-12
        most = np.abs(pushes).max(axis=0)
        assert (most <= ARM.torque_limit_nm / 4 + 1e-9).all()
        assert most[:3] == pytest.approx(ARM.torque_limit_nm[:3] / 4)  # the bound is reached
        slope = np.abs(np.diff(pushes, axis=0)).max(axis=0) / np.diff(depths)[0]
        assert (slope < 0.3 * ARM.kp + (ARM.kd * abs(speed)) / 0.03 + 1e-6).all()  # steep nowhere
        if speed == 0.0:
            assert (pushes[depths > 1e-6] > 0.0).all()
            assert pushes[np.searchsorted(depths, 0.005)].max() < 0.15  # rest on a limit is left alone


def test_only_joints_beyond_their_limits_feel_it():
    q = MIDDLE.copy()
    before, beyond = floating(q, np.ones(N), 0.7)
    assert beyond == 0.0
    q[2] = LOWER[2] - 0.1
    after, beyond = floating(q, np.ones(N), 0.7)
    assert beyond == pytest.approx(0.1)
    others = [i for i in range(N) if i != 2]
    assert np.array_equal(after[others], before[others])
    assert (after[:, mit_laws.TAU] == 0.7).all()  # the weight is carried as before
    assert after[2, mit_laws.Q] == pytest.approx(LOWER[2]) and after[2, mit_laws.KP] == pytest.approx(24.0)


@pytest.mark.parametrize("inertia", [0.03, 0.3, 1.5])
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_pushed_joint_returns_gently_and_does_not_ring(inertia, friction):
    """Motor loop at 4 kHz on fresh positions, host at 250 Hz on positions one tick old; through the real frame."""
    joint, q, dq, seen, path = 1, LOWER[1] - 0.15, 0.0, LOWER[1] - 0.15, []
    kind = ARM.motors[joint].type
    for _ in range(1500):
        pose = MIDDLE.copy()
        pose[joint] = seen
        rates = np.zeros(N)
        rates[joint] = dq
        row = floating(pose, rates)[0][joint].tolist()
        p, v, kp, kd, tau = decode_mit(kind, pack_mit(ranges_of(kind), *row))
        seen = q  # what the next tick is computed from
        for _step in range(16):
            drive = kp * (p - q) + kd * (v - dq) + tau
            if abs(dq) < 1e-4 and abs(drive) <= friction:
                dq = 0.0
                continue
            dq += (drive - np.copysign(friction, dq or drive)) / inertia / 4000
            q += dq / 4000
        path.append(q)
        assert abs(dq) < 1.0
    depth = LOWER[joint] - np.array(path)
    assert depth[-1] < 0.02  # what is left is too little for the friction
    assert (depth - np.minimum.accumulate(depth)).max() < 0.003  # it does not turn round


@pytest.mark.parametrize("kp", [0.0, 1.0, 80.0])
@pytest.mark.parametrize("limit", [2.0, 10.0, 28.0])
def test_the_clip_holds_behind_the_frame_whose_fields_are_narrow(kp, limit):
    """A far set-point, and a blow, ask for more than the torque field could take back."""
    random = np.random.default_rng(7)
    for _ in range(300):
        q, goal = random.uniform(-3, 3, 2)
        dq = random.uniform(-9, 9)
        out = np.array([[goal, random.uniform(-2, 2), kp, random.uniform(0, 5), random.uniform(-20, 20)]])
        free = float(motor_torque(out, q, dq)[0])
        held = mit_laws.clip_torque(out, np.array([q]), np.array([dq]), np.array([limit]))
        assert held == (abs(free) > limit)
        p, v, gain, damping, tau = decode_mit("DM4340", encode_mit("DM4340", *out[0]))
        torque = gain * (p - q) + damping * (v - dq) + tau
        assert abs(torque) < limit + 0.25  # the frame's steps: 0.12 of kp, 1 mrad/s … of 4095
        if held:
            assert abs(float(motor_torque(out, q, dq)[0])) == pytest.approx(limit)
            assert np.sign(torque) == np.sign(free)
