import numpy as np
import pytest

from lerobot_robot_yam.control.laws.set_point import SetPoint

DT = 0.004
SPEED, ACCELERATION = 1.5, 30.0


END = 5.0


def make(n=1, lower=-3.0, upper=3.0):
    limits = [np.full(n, limit) for limit in (SPEED, ACCELERATION, lower, upper, END)]
    return SetPoint(*limits)


def run(setpoint, seconds, start=0.0, target=None, fps=30):
    """Rows of (t, q, dq) as asked for; `target(t)` is aimed at fps times a second."""
    rows, aim_at = [], start
    for t in np.arange(start, start + seconds, DT):
        if target is not None and t >= aim_at:
            setpoint.set_target(np.array([target(t)]), t)
            aim_at += 1 / fps
        setpoint.step(t, DT)
        rows.append((t, *setpoint.asked[:, 0]))
    return np.array(rows)


@pytest.mark.parametrize("fps", [30, 60])
def test_a_stream_is_followed_smoothly_and_one_caller_period_late(fps):
    def wave(t):
        return 0.3 * np.sin(np.pi * t)

    setpoint = make()
    rows = run(setpoint, 6.0, target=wave, fps=fps)[250:]
    late = 1 / fps
    assert np.sqrt(np.mean((rows[:, 1] - wave(rows[:, 0] - late)) ** 2)) < 0.005
    speed = 0.3 * np.pi * np.cos(np.pi * (rows[:, 0] - late))
    assert np.sqrt(np.mean((rows[:, 2] - speed) ** 2)) < 0.06  # dq* is the slope, without the stream's steps


def test_a_far_target_is_approached_within_the_speed_limit_and_reached():
    setpoint = make()
    setpoint.seed(np.array([-1.0]))
    setpoint.set_target(np.array([1.0]), 0.0)
    rows = run(setpoint, 2.0)
    steps = np.abs(np.diff(rows[:, 1]))
    assert steps.max() <= SPEED * DT + 1e-12
    assert np.abs(np.diff(rows[:, 2])).max() <= ACCELERATION * DT + 1e-9
    assert setpoint.arrived and setpoint.q[0] == pytest.approx(1.0, abs=1e-3)
    assert rows[:, 1].max() < 1.01


@pytest.mark.parametrize("dq", [0.0, 1.5, 6.0, -57.0])
def test_a_target_that_claims_a_speed_does_not_lead_the_set_point_away_from_it(dq):
    setpoint = make()
    for tick in range(1000):
        if tick % 8 == 0:
            setpoint.set_target(np.array([0.2]), tick * DT, np.array([dq]))
        setpoint.step(tick * DT, DT)
    assert setpoint.asked[0, 0] == pytest.approx(0.2, abs=SPEED**2 / (2 * ACCELERATION) + SPEED * DT + 1e-12)


def test_a_stream_that_tells_its_speed_and_comes_unevenly_is_followed_smoothly_and_without_lag():
    rng, setpoint, due, off, jolts = np.random.default_rng(0), make(), 0.0, [], []
    for t in np.arange(0.0, 8.0, DT):
        if t >= due:
            age = rng.uniform(0.0, DT)
            q, dq = 0.5 * np.sin(t - age), 0.5 * np.cos(t - age)
            setpoint.set_target(np.array([q]), t, np.array([dq]), age)
            due = t + rng.uniform(4 * DT, 7 * DT)
        setpoint.step(t, DT)
        off.append(setpoint.asked[0, 0] - 0.5 * np.sin(t))
        jolts.append(setpoint.asked_ddq[0] + 0.5 * np.sin(t))
    off, jolts = np.abs(off[250:]), np.abs(jolts[250:])
    assert off.max() < 0.001 and jolts.max() < 0.2 * ACCELERATION  # without the speed: 0.014 rad, the whole limit


@pytest.mark.parametrize(
    "speed, acceleration, amplitude, late_s, above",
    [(4.0, 30.0, 0.2, 0.025, 1.16), (4.0, 60.0, 0.2, 0.001, 1.01), (4.0, 50.0, 0.3, 0.012, 1.15)],
)
def test_a_leader_in_full_swing_is_caught_up_with(speed, acceleration, amplitude, late_s, above):
    # The first one turns with 31.6 rad/s², more than the set-point may: a chase that brakes too late swings for ever.
    setpoint, rows, w = make(), [], 4 * np.pi
    setpoint.limit_speed(np.array([speed]))
    setpoint.limit_acceleration(np.array([acceleration]))
    for t in np.arange(0.0, 3.0, DT):
        setpoint.track(np.array([amplitude * np.sin(w * t)]), np.array([amplitude * w * np.cos(w * t)]), t)
        setpoint.step(t, DT)
        assert abs(setpoint.dq[0]) <= speed + 1e-9 and abs(setpoint.asked_ddq[0]) <= acceleration + 1e-6
        rows.append((t, setpoint.asked[0, 0]))
    times, q = np.array(rows)[250:].T
    phase = np.angle(np.sum(q * np.exp(-1j * w * times)) / np.sum(np.sin(w * times) * np.exp(-1j * w * times)))
    assert abs(phase) / w <= late_s
    assert np.abs(q).max() <= above * amplitude


def test_seeding_outside_the_limits_does_not_jump_and_only_moves_inwards():
    setpoint = make(lower=0.0)
    setpoint.seed(np.array([-0.1]))
    setpoint.set_target(np.array([-0.5]), 0.0)
    rows = run(setpoint, 0.5)
    assert rows[0, 1] == pytest.approx(-0.1, abs=SPEED * DT)
    assert rows[:, 1].min() >= -0.1
    assert np.diff(rows[:, 1]).min() > -2e-3  # no way back out but for the overshoot of braking
    assert rows[-1, 1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("towards", [-1.0, 1.0])
def test_a_moving_target_does_not_take_it_to_the_end_of_its_range_at_full_speed(towards):
    setpoint = make(lower=-1.0, upper=1.0)
    rows = run(setpoint, 1.5, target=lambda t: towards * 3.0 * t)  # on and on, beyond the end
    left, speed = 1.0 - towards * rows[:, 1], towards * rows[:, 2]
    assert speed.max() == pytest.approx(SPEED)
    assert np.all(speed <= np.sqrt(2 * END * np.maximum(left, 0.0)) + ACCELERATION * DT)
    assert rows[-1, 1] == pytest.approx(towards, abs=1e-3) and abs(rows[-1, 2]) < 0.02


def test_a_stream_that_ends_comes_to_rest_near_its_last_target():
    setpoint = make()
    run(setpoint, 1.0, target=lambda t: 0.8 * t)
    last = setpoint.target[0]
    rows = run(setpoint, 1.0, start=1.0)
    assert setpoint.arrived
    assert setpoint.q[0] == pytest.approx(last, abs=1e-3)
    assert rows[:, 1].max() < last + 0.02


def test_position_speed_and_acceleration_that_are_asked_for_belong_to_one_motion():
    setpoint, rng = make(), np.random.default_rng(0)
    rows = []
    for tick in range(1000):
        if tick % 8 == 0:
            setpoint.set_target(rng.uniform(-0.5, 0.5, 1), tick * DT)
        setpoint.step(tick * DT, DT)
        rows.append((*setpoint.asked[:, 0], setpoint.asked_ddq[0]))
    q, dq, ddq = np.array(rows)[1:].T
    np.testing.assert_allclose(np.diff(q) / DT, dq[1:], atol=1e-9)
    np.testing.assert_allclose(np.diff(dq) / DT, (ddq[1:] + ddq[:-1]) / 2.0, atol=1e-9)
    assert np.abs(dq).max() <= SPEED + 1e-9 and np.abs(ddq).max() <= ACCELERATION + 1e-6
    assert np.abs(np.diff(ddq)).max() <= ACCELERATION + 1e-6  # from none to all of it, or to as much of its opposite


def test_holding_back_takes_a_share_of_the_acceleration_and_keeps_to_the_range():
    setpoint = make(n=2, lower=np.array([-3.0, -3.0]), upper=np.array([3.0, 0.001]))
    setpoint.set_target(np.array([1.0, 1.0]), 0.0)
    for tick in range(3):
        setpoint.step(tick * DT, DT)
    before = setpoint.asked_ddq.copy()
    setpoint.hold_back(np.array([0.25, 1.0]))
    assert before[0] == pytest.approx(ACCELERATION)
    np.testing.assert_allclose(setpoint.asked_ddq, [0.25 * before[0], before[1]])
    for tick in range(3, 400):
        setpoint.step(tick * DT, DT)
        if tick < 50:
            setpoint.hold_back(np.array([0.5, 0.5]))
        assert setpoint.asked[0, 1] <= 0.001
    assert setpoint.arrived


@pytest.mark.parametrize("change", ["seed", "reseed", "fall_back", "shift"])
def test_what_starts_again_is_asked_for_at_once(change):
    """Nothing of the plans before is left in the mean."""
    setpoint = make()
    run(setpoint, 0.5, target=lambda t: 1.2 * t)
    speed = setpoint.asked[1, 0]
    getattr(setpoint, change)(*([np.array([-0.4])] if change == "seed" else [0, -0.4]))
    assert setpoint.asked[0, 0] == -0.4
    assert setpoint.asked[1, 0] == (speed if change == "shift" else 0.0)


@pytest.mark.parametrize("again", [False, True])
def test_stop_brakes_within_the_acceleration_limit(again):
    """Also if it is called at each tick, and if targets keep coming."""
    setpoint = make()
    run(setpoint, 1.0, target=lambda t: 1.2 * t)
    before, speed = setpoint.q[0], setpoint.dq[0]
    setpoint.stop()
    speeds = [speed]
    for tick in range(int(0.1 / DT)):
        if again:
            setpoint.set_target(np.array([1.2 + tick * DT]), 1.0 + tick * DT)
            setpoint.stop()
        setpoint.step(1.0 + tick * DT, DT)
        speeds.append(setpoint.dq[0])
    assert np.abs(np.diff(speeds)).max() <= ACCELERATION * DT + 1e-9
    assert setpoint.arrived and not setpoint.asked[1].any()
    assert before < setpoint.q[0] < before + speed**2 / (2.0 * ACCELERATION)
