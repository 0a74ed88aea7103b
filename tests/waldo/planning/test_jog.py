"""Jogging and servoing, tick by tick: the right way, within the limits, and over when it is not renewed."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.tool_pose import rotation_vector
from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.controller.motion import Motion
from lerobot_robot_yam.waldo.controller.plant import SimulatedArm
from lerobot_robot_yam.waldo.planning.jog import JOG_S, JointJog, LineJog, Play
from lerobot_robot_yam.waldo.planning.motion_plan import JOG_SHARE, LINE_SPEED_M_S, STOP_FACTOR
from lerobot_robot_yam.waldo.poses import AXES, FRAMES
from tests.support.tiers import spread
from tests.support.waldo_desk import planner_of

TICK_S = 0.01


@pytest.fixture
def planner():
    return planner_of()


class Run:
    """Steps the motion of an arm and keeps its set-points; `hold` renews a command every 50 ms, as Commander does."""

    def __init__(self, planner, q=None):
        self.planner = planner
        self.arm = SimulatedArm(planner.hardware, planner.home_q if q is None else q)
        self.motion = Motion(planner, self.arm.read())
        self.motion.step(0.0, self.arm.read())
        self.ticks, self.q, self.dq = 0, [self.motion.q], [self.motion.dq]

    @property
    def now_s(self):
        return self.ticks * TICK_S

    @property
    def still(self):
        return not self.motion.dq.any()

    def jog(self, speeds, duration_s=JOG_S):
        self.motion.stream(lambda: JointJog(self.planner, speeds, self.now_s, duration_s))

    def jog_line(self, frame, speeds):
        self.motion.stream(lambda: LineJog(self.planner, frame, speeds, self.motion.setpoint, self.now_s))

    def servo(self, target, **shares):
        q, dq = self.motion.setpoint
        self.motion.stream(lambda: Play(self.planner.joints(q, target, start_dq=dq, **shares)))

    def go(self, seconds):
        for _ in range(round(seconds / TICK_S)):
            self.ticks += 1
            self.motion.step(self.now_s, self.arm.read())
            self.arm.follow(self.motion.q, self.motion.dq, None, TICK_S)
            self.q.append(self.motion.q.copy())
            self.dq.append(self.motion.dq.copy())

    def hold(self, command, seconds):
        for _ in range(round(seconds / 0.05)):
            command()
            self.go(0.05)

    def check(self):
        """No set-point beyond a limit; none that the one before does not lead to."""
        q, dq, limits = np.array(self.q), np.array(self.dq), self.planner.limits
        assert (q >= self.planner.lower - 1e-9).all() and (q <= self.planner.upper + 1e-9).all()
        assert (np.abs(dq) <= limits.speed + 1e-9).all()
        assert (np.abs(np.diff(q, axis=0)) / TICK_S <= limits.speed + 1e-6).all()
        assert (np.abs(np.diff(dq, axis=0)) / TICK_S <= (STOP_FACTOR + 0.5) * limits.acceleration).all()


def test_a_held_joint_runs_through_and_stops_soon_after_it_is_let_go(planner):
    run = Run(planner)
    run.hold(lambda: run.jog({0: -0.4}), 1.0)
    assert run.dq[-1][0] == pytest.approx(-0.4 * JOG_SHARE * planner.limits.speed[0])
    run.go(0.4)
    run.check()
    assert run.still and not np.array(run.dq)[:, 1:].any()


def test_a_jog_that_is_not_renewed_lasts_its_duration(planner):
    run = Run(planner)
    run.jog({1: 0.5, 4: -0.2})
    run.go(0.1)
    moving = run.dq[-1].copy()
    run.go(0.3)
    assert moving[1] > 0.0 > moving[4] and run.still
    run.check()


def test_a_jog_against_a_limit_ends_at_it(planner):
    start = planner.home_q.copy()
    start[0] = planner.lower[0] + 0.2
    run = Run(planner, start)
    run.hold(lambda: run.jog({0: -1.0}), 1.5)
    run.check()
    assert run.q[-1][0] == pytest.approx(planner.lower[0], abs=1e-3)


def test_from_outside_a_limit_it_jogs_inwards_only(planner):
    start = planner.home_q.copy()
    start[2] = planner.lower[2] - 0.002
    for direction, expected in ((-1.0, start[2]), (1.0, start[2] + 0.1)):
        run = Run(planner, start)
        run.hold(lambda way=direction, run=run: run.jog({2: way}), 0.5)
        assert run.q[-1][2] >= expected and (direction > 0.0) == (run.q[-1][2] > start[2])


def test_an_arm_at_rest_can_be_jogged_up(planner):
    """Joints 2 and 3 lie on their lower stops, and are measured a little below."""
    run = Run(planner, planner.hardware.rest_q - [0.0, 0.002, 0.002, 0.0, 0.0, 0.0])
    run.hold(lambda: run.jog_line("WRF", {"Z": 0.5}), 1.0)
    before, after = planner.pose(np.array([run.q[0], run.q[-1]]))[:, :3, 3]
    assert after[2] > before[2] + 0.05 and np.abs((after - before)[:2]).max() < 5e-4


@pytest.mark.parametrize("frame, axis", [("WRF", "Z"), ("WRF", "Y"), ("TRF", "X"), ("TRF", "RZ"), ("WRF", "RX")])
def test_a_held_axis_moves_the_tool_along_it_alone(planner, frame, axis):
    run = Run(planner)
    before = planner.pose(run.q[0])
    run.hold(lambda: run.jog_line(frame, {axis: 0.4}), 0.8)
    moving = np.abs(run.dq[-1]).max()
    run.go(0.4)
    run.check()
    after = planner.pose(run.q[-1])
    shift, turn = after[:3, 3] - before[:3, 3], rotation_vector(after[:3, :3] @ before[:3, :3].T)
    if frame == "TRF":
        shift, turn = before[:3, :3].T @ shift, before[:3, :3].T @ turn
    moved = np.concatenate([1000.0 * shift, np.degrees(turn)])
    index = AXES.index(axis)
    assert moved[index] > 10.0 and np.abs(np.delete(moved, index)).max() < 0.05
    assert moving > 0.0 and run.still


def test_a_held_axis_stops_at_the_end_of_the_reach_and_stays(planner):
    run = Run(planner)
    run.hold(lambda: run.jog_line("WRF", {"X": 1.0}), 4.0)
    there = run.q[-1].copy()
    run.hold(lambda: run.jog_line("WRF", {"X": 1.0}), 0.5)
    run.check()
    assert run.still and np.abs(run.q[-1] - there).max() < 1e-6
    pose = planner.pose(np.array(run.q))
    assert np.abs(pose[:, 1:3, 3] - pose[0, 1:3, 3]).max() < 5e-4  # straight to the end
    run.hold(lambda: run.jog_line("WRF", {"X": -0.5}), 0.5)
    assert planner.pose(run.q[-1])[0, 3] < pose[-1, 0, 3] - 0.005


@pytest.mark.parametrize("seed", spread(range(6), 0, 5))
def test_whatever_is_jogged_it_stays_within_the_limits(planner, seed):
    draw = np.random.default_rng(seed)
    run = Run(planner, draw.uniform(planner.lower, planner.upper))
    for _ in range(8):
        axis, frame, speed = draw.choice(AXES), draw.choice(FRAMES), draw.uniform(-1, 1)
        kind = draw.integers(3)
        if kind == 0:
            joint = int(draw.integers(6))
            run.hold(lambda j=joint, s=speed: run.jog({j: s}), 0.4)
        elif kind == 1:
            run.hold(lambda f=frame, a=axis, s=speed: run.jog_line(f, {a: s}), 0.6)
        else:
            run.go(0.3)
    run.check()


def jog_down(run, by):
    if by == "joint":
        run.jog({2: -0.6})
    else:
        run.jog_line("WRF", {"Z": -1.0})


@pytest.mark.parametrize("seed", spread([106, 118, 138, 141], 1))
def test_near_singularities_no_joint_is_jerked(planner, seed):
    draw = np.random.default_rng(seed)
    run = Run(planner, draw.uniform(planner.lower, planner.upper))
    for _ in range(6):
        frame, axis, speed = draw.choice(FRAMES), draw.choice(AXES), draw.uniform(-1, 1)
        run.hold(lambda f=frame, a=axis, s=speed: run.jog_line(f, {a: s}), 0.8)
    run.check()


@pytest.mark.parametrize("ticks", [5, 22, 27, 30, 33])
@pytest.mark.parametrize("then", ["stop", "servo", "nothing"])
def test_near_a_limit_whatever_comes_after_a_jog_keeps_it(planner, ticks, then):
    start = planner.home_q.copy()
    start[0] = planner.upper[0] - 0.25
    run = Run(planner, start)
    for _ in range(ticks):
        run.jog({0: 1.0})
        run.go(TICK_S)
    if then == "stop":
        run.motion.stop(run.now_s)
    elif then == "servo":
        with contextlib.suppress(PlanError):  # "moves too fast to keep its limit": then the jog goes on to its end
            run.servo(start)
    run.go(1.5)
    run.check()
    assert run.still


@pytest.mark.parametrize("by", ["joint", "axis"])
def test_a_jog_stops_short_of_a_floor(planner, by):
    planner.keep_clear(WorkspaceConfig(floor_z_m=0.05))
    run = Run(planner)
    run.hold(lambda: jog_down(run, by), 2.0)
    run.check()
    tool = planner.pose(np.array(run.q))[:, :3, 3]
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=1) / TICK_S
    slower = int(np.argmax(np.diff(speed) < -5e-3))
    assert (np.diff(speed[slower:]) <= 1e-3).all() and run.still  # it does not try again and again
    assert planner.conflict(np.array(run.q)) is None
    assert planner.pose(run.q[-1])[2, 3] < planner.pose(run.q[0])[2, 3] - 0.02


@pytest.mark.parametrize("by", ["joint", "axis"])
def test_a_jog_that_was_let_go_tries_again(planner, by):
    """What stood in the way may have been taken away."""
    planner.keep_clear(WorkspaceConfig(floor_z_m=0.05))
    run = Run(planner)
    for _ in range(2):
        run.hold(lambda: jog_down(run, by), 1.2)
        run.go(0.3)
        stopped_m = planner.pose(run.q[-1])[2, 3]
        planner.keep_clear(WorkspaceConfig())
    assert stopped_m < planner.pose(run.q[len(run.q) // 2])[2, 3] - 0.02
    run.check()


def test_the_newest_target_counts(planner):
    run = Run(planner)
    near, far = planner.home_q + 0.02, planner.home_q + [0.7, 0, 0, 0, 0, 0]
    run.servo(far)
    run.go(0.2)
    run.servo(near)
    run.go(1.5)
    run.check()
    assert np.abs(run.q[-1] - near).max() < 1e-6 and np.array(run.q)[:, 0].max() < planner.home_q[0] + 0.3


def test_a_dragged_tool_follows_and_holds_its_last_pose(planner):
    run = Run(planner)
    pose = planner.pose(planner.home_q)
    for _ in range(20):
        pose = pose.copy()
        pose[2, 3] += 0.002
        run.servo(planner.inverse(pose, run.motion.q, turn_over=False), speed=0.8, accel=0.5)
        run.go(0.05)
    run.go(1.0)
    run.check()
    assert np.abs(planner.pose(run.q[-1]) - pose).max() < 1e-4 and run.still


def test_a_refused_command_leaves_the_one_before(planner):
    run = Run(planner)
    run.servo(planner.home_q + 0.1)
    away = planner.pose(planner.home_q)
    away[0, 3] += 3.0
    for refused in (
        lambda: run.servo(planner.inverse(away, run.motion.q, turn_over=False)),
        lambda: run.servo(np.full(6, np.nan)),
        lambda: run.jog({9: 0.3}),
        lambda: run.jog({0: np.nan}),
        lambda: run.jog({0: 0.3}, np.inf),
        lambda: run.jog_line("WRF", {"Q": 0.3}),
        lambda: run.jog_line("NOPE", {"X": 0.3}),
        lambda: run.jog_line("WRF", {"X": 3.0}),
    ):
        with pytest.raises(PlanError):
            refused()
    run.go(1.5)
    assert np.abs(run.q[-1] - planner.home_q - 0.1).max() < 1e-6


def test_a_stop_ends_everything_at_once(planner):
    run = Run(planner)
    run.hold(lambda: run.jog_line("WRF", {"Y": 1.0}), 0.6)
    before, after = planner.pose(np.array(run.q[-2:]))[:, :3, 3]
    assert np.linalg.norm(after - before) / TICK_S > 0.9 * LINE_SPEED_M_S
    run.motion.stop(run.now_s)
    run.go(0.3)
    run.check()
    assert run.still
