"""No stream of targets drives a joint beyond 1.1 times its speed limit, by the rig's truth; nor does any lag more."""

from contextlib import ExitStack

import numpy as np
import pytest

from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS, load_gripper
from scripts import recorders
from tests.support.rigged import rig_of, session_on, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
MIDDLE = np.array([0.0, 1.2, 1.2, 0.0, 0.0, 0.0])
MOST = 1.1  # of the speed limit


def uniform(rng, amplitude, _):
    """Anywhere near the middle, each frame anew."""
    return lambda t: rng.uniform(-amplitude, amplitude, 6)


def flips(rng, amplitude, rate_hz):
    """From one side to the other at any time, mostly all joints at once."""
    side, due = rng.choice([-1.0, 1.0], 6), [0.0]

    def offset(t):
        if t >= due[0]:
            due[0] = t + rng.uniform(0.5, 1.5) / rate_hz
            side[rng.random(6) < 0.7] *= -1.0
        return amplitude * side

    return offset


def square(rng, amplitude, rate_hz):
    """The same at one rate, each joint with a sign of its own: what could swing up swings up."""
    sign = rng.choice([-1.0, 1.0], 6)
    return lambda t: amplitude * sign * (1.0 if (t * rate_hz) % 1.0 < 0.5 else -1.0)


def chirp(rng, amplitude, rate_hz):
    """Slow at first, and after two seconds at that rate."""
    sign = rng.choice([-1.0, 1.0], 6)
    return lambda t: amplitude * sign * np.sin(np.pi * rate_hz * t * t / 2.0)


KINDS = {stream.__name__: stream for stream in (uniform, flips, square, chirp)}


class Driven:
    """An arm on a rig of its own, and what drives it."""

    def __init__(self, rig, config):
        self.rig, self.session = rig, session_on(rig, config)
        self.session.start()
        self.port = self.session[CHANNEL]
        self.limit = self.port.hardware.speed_limit[:6]

    def fastest(self, offset, fps, seconds, dq=lambda t: None):
        """(6,) largest true speed in shares of the limit while targets come `fps` times a second; NaN after a touch."""
        rig, clock = self.rig, self.session.clock
        track(self.session, {CHANNEL: MIDDLE}, 0.5 + 1.2 / float(self.limit.min()))
        recorders.watch_start(rig, CHANNEL)
        begin, frame = clock.now(), 0
        while (t := clock.now() - begin) < seconds:
            self.port.write_target(MIDDLE + offset(t), 0.5, dq=dq(t))
            frame += 1
            clock.sleep(max(begin + frame / fps - clock.now(), 1e-4))
        seen = recorders.watch(rig, CHANNEL)
        if seen["touched_at_s"] > 0.0:  # it has met itself or the table: an obstacle
            return np.full(6, np.nan)
        return np.array(seen["max_speed_rad_s"][:6]) / self.limit


def stops_of(gripper):
    calibration = load_gripper(gripper).calibration
    return None if calibration is None else calibration.nominal_stops_rad.tolist()


@pytest.fixture
def drive():
    """`drive(arm, ...)`: a `Driven` arm, which ends with the test."""
    with ExitStack() as stack:

        def start(arm, gripper="linear_4310", friction=1.0, **fields):
            options = {"arms": [CHANNEL], "arm": arm, "gripper": gripper, "friction": friction}
            rig = stack.enter_context(rig_of("lockstep", **options))
            fields = {"arm": arm, "gripper": gripper, "gripper_stops_rad": stops_of(gripper)} | fields
            driven = Driven(rig, sim_config(rig, CHANNEL, **fields))
            stack.callback(driven.session.discard)
            return driven

        yield start


@pytest.mark.long
@pytest.mark.parametrize(
    ("arm", "fields", "kind", "flips_hz", "fps"),
    spread(
        [
            ("yam", {}, "uniform", 0.0, 8),
            ("yam", {}, "flips", 3.0, 30),
            ("yam", {"speed_limit_rad_s": 0.5}, "uniform", 0.0, 10),
            ("yam", {"speed_limit_rad_s": 3.0}, "uniform", 0.0, 5),
            ("yam", {"rate_hz": 125.0}, "uniform", 0.0, 8),
            ("yam", {"rate_hz": 100.0}, "uniform", 0.0, 5),
            ("big_yam", {}, "uniform", 0.0, 10),  # torque ends before acceleration does
            ("yam_ultra", {}, "square", 1.5, 30),
            ("yam", {"teleop_speed": "fast"}, "uniform", 0.0, 8),
            ("yam", {"teleop_speed": "normal"}, "square", 1.5, 30),
            ("yam", {"acceleration_limit_rad_s2": 100.0, "speed_limit_rad_s": 3.0}, "uniform", 0.0, 8),
            ("big_yam", {"teleop_speed": "fast"}, "square", 1.5, 30),
        ],
        1,
    ),
)
def test_targets_that_jump_drive_no_joint_beyond_its_speed(drive, arm, fields, kind, flips_hz, fps):
    driven = drive(arm, **fields)
    fastest = driven.fastest(KINDS[kind](np.random.default_rng(2), 0.6, flips_hz), fps, 3.0)
    assert 0.95 < fastest.max() < MOST, fastest


def test_targets_that_claim_a_speed_drive_no_joint_beyond_its_speed(drive):
    rng = np.random.default_rng(2)
    fastest = drive("yam").fastest(flips(rng, 0.3, 3.0), 30, 3.0, dq=lambda t: rng.choice([-9.0, 9.0], 6))
    assert 0.95 < fastest.max() < MOST, fastest


@pytest.mark.long
@pytest.mark.parametrize(("fps", "most_ms"), [(30, 39.0), (60, 22.0)])
def test_a_wave_is_followed_no_later_than_before(drive, fps, most_ms):
    """One caller period and 4 ms: joints 1 to 3, which are stiff. The wrist's friction makes it 10 ms more."""
    driven = drive("yam")
    track(driven.session, {CHANNEL: MIDDLE}, 1.0)
    clock, rows = driven.session.clock, []
    begin, frame = clock.now(), 0
    while (t := clock.now() - begin) < 4.0:
        driven.port.write_target(MIDDLE + 0.3 * np.sin(np.pi * t), 0.5)
        rows.append((t, *driven.rig.state()["arms"][CHANNEL]["q"][:6]))
        frame += 1
        clock.sleep(max(begin + frame / fps - clock.now(), 1e-4))
    t, q = np.array(rows)[fps:, 0], np.array(rows)[fps:, 1:] - MIDDLE
    lags_s = np.arange(0.0, 0.08, 0.0005)
    errors = [np.square(q - 0.3 * np.sin(np.pi * (t - lag_s))[:, None]).mean(axis=0) for lag_s in lags_s]
    lag_ms = lags_s[np.argmin(errors, axis=0)] * 1e3
    assert lag_ms[:3].max() <= most_ms and lag_ms[3:].max() <= most_ms + 11.0, lag_ms


@pytest.mark.long
@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("arm", ARMS)
def test_random_streams_drive_no_joint_beyond_its_speed(drive, arm, seed, record_property):
    rng = np.random.default_rng([seed, ARMS.index(arm)])
    gripper = str(rng.choice([name for name in GRIPPERS if name != "yam_teaching_handle"]))
    limit_rad_s = [None, 0.5, 1.0, 3.0][rng.integers(4)]
    friction = float(rng.choice([0.0, 1.0, 3.0]))
    driven, worst = drive(arm, gripper, friction=friction, speed_limit_rad_s=limit_rad_s), 0.0
    for _ in range(8):
        kind = str(rng.choice(list(KINDS)))
        amplitude, rate_hz = float(rng.choice([0.05, 0.2, 0.6])), float(rng.uniform(0.5, 8.0))
        joints = np.ones(6) if rng.random() < 0.6 else rng.random(6) < 0.5
        offset = KINDS[kind](rng, amplitude * joints, rate_hz)
        fps = float(rng.choice([5, 8, 10, 15, 20, 30, 60, 125, 250]))
        claims = (lambda t: rng.uniform(-3.0, 3.0, 6)) if rng.random() < 0.2 else (lambda t: None)
        fastest = driven.fastest(offset, fps, 2.0, dq=claims)
        worst = max(worst, float(np.nanmax(fastest, initial=0.0)))
        assert not (fastest > MOST).any(), (gripper, limit_rad_s, kind, amplitude, rate_hz, fps, fastest)
    record_property("worst", round(worst, 3))
