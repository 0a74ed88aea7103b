"""Motion of arms: one arm to a goal that a person may change on the way, or all arms along a recorded motion.

The control loop limits an arm's speed towards a goal. A recorded motion is slowed to the limits before it starts. The
control loop only reports that its collision guard holds a set-point back; `HeldBack` finds the parts that cause it.
"""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.collision.clearance import Clearance
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD
from lerobot_robot_yam.arm.kinematics import PoseTracker, YamKinematics
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.validation import finite_number
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.playback import APPROACH_RAD_S, Playback, approach_s, ready, replay
from lerobot_robot_yam.session.trajectory import Trajectory, soft_way
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited

_REACHED = 1e-3  # distance at which a goal counts as reached, rad or fraction of the gripper's stroke
_PROGRESS = 5e-3  # minimum progress towards the goal per `_STUCK_S`, rad or fraction of the stroke
_STUCK_S = 1.0  # time without `_PROGRESS` after which the arm holds, s
_OFF_M = 0.03  # position error of a dragged tool above which its target counts as out of reach, m
_RAMP_S = 0.4  # duration of the ramp between full speed and rest for a pause, s
_SETTLES_S = 1.0  # maximum wait for the set-points to reach the last targets, s
_LONGEST_S = 0.1  # maximum advance of a motion per step, s: after a gap in sending, the motion does not jump ahead
_AHEAD_RAD = 0.05  # look-ahead towards the goal, rad: the guard stops an arm at most this far from a conflict


class DrivenArm:
    """Sender of one arm's targets. Use it from one thread only.

    Attributes:
        goal: goal (n,) of all motors while the arm moves to it, rad and 0 … 1, else None.
        shown: goal (n,), or the set-points if there is no goal. Any thread may read it.
    """

    def __init__(self, client: ArmClient):
        self.client, self.hardware = client, client.hardware
        self.goal: np.ndarray | None = None
        self.shown = np.array(client.published().setpoints)
        self._least, self._since_s = np.inf, 0.0
        self._playback: Playback | None = None
        self._tracker: PoseTracker | None = None

    def move(self, motor: int, value: float, now: float) -> None:
        """Move one joint to an angle, rad, or the gripper to an opening, 0 … 1. The other motors keep their goals.

        Raises:
            ActionError: the motor does not exist, or the value is not finite or beyond a limit. Nothing changes.
            YamError: the arm does not accept targets.
        """
        hw = self.hardware
        if not 0 <= motor < hw.n:
            raise ActionError(f"{hw.name} has no motor {motor}; it has {hw.n}")
        what = hw.motors[motor].name
        number = finite_number(hw.name, what, value)
        if not hw.lower[motor] - RANGE_TOLERANCE_RAD <= number <= hw.upper[motor] + RANGE_TOLERANCE_RAD:
            reach = f"{hw.lower[motor]:.2f} … {hw.upper[motor]:.2f}"
            raise ActionError(f"{hw.name}: {what} cannot go to {number:.2f}, only within {reach}; nothing moves")
        goal = self._present()
        goal[motor] = number
        self._set(goal, now)

    def drag(self, pose: np.ndarray, now: float) -> str:
        """Move the tool to a pose (4, 4) in the arm's base frame. Return a notice for the person, or "".

        Raises:
            ActionError: `pose` is malformed. Nothing changes.
            ConfigError: this arm has no joints to move its tool with.
            YamError: the arm does not accept targets.
        """
        hw, goal = self.hardware, self._present()
        if self._tracker is None:
            if not hw.joints:
                raise ConfigError(f"{hw.name} has no joints to move its tool with")
            self._tracker = PoseTracker(YamKinematics(hw.arm, hw.gripper), goal[: hw.joints])
        if not np.array_equal(self._tracker.q, goal[: hw.joints]):  # the arm was moved by other means since
            self._tracker.restart(goal[: hw.joints])
        result = self._tracker.solve(pose)
        goal[: hw.joints] = result.q
        self._set(goal, now)
        if result.error_m > _OFF_M:
            return f"{hw.name}: the tool cannot get there; it goes as near as {result.error_m * 100:.0f} cm"
        return ""

    def glide(self, goal: np.ndarray) -> None:
        """Move smoothly to a pose (n,), straight in joint space. Raises YamError: the arm is in fault or silent."""
        self.stay()
        start = ready([self.client])
        speed = np.minimum(self.hardware.speed_limit, APPROACH_RAD_S)
        self._playback = Playback([self.client], soft_way(start, goal, approach_s(goal - start, speed)))

    def stay(self) -> None:
        """End the motion. No further targets are sent."""
        self.goal = self._playback = None

    def _present(self) -> np.ndarray:
        """Return the goal (n,), or else the set-points. Raises YamError: the arm does not accept targets."""
        state = self.client.newest()
        _check_takes_targets(self.client)
        return np.array(state.setpoints) if self.goal is None else self.goal.copy()

    def _set(self, goal: np.ndarray, now: float) -> None:
        self._playback = None
        self.goal = np.clip(goal, self.hardware.lower, self.hardware.upper)
        self._least, self._since_s = np.inf, now

    def step(self, now: float) -> bool:
        """Send the current target. If the arm makes no progress towards its goal, hold it and return False.

        Raises:
            YamError: the arm no longer accepts targets.
        """
        self.shown = np.array(self.client.published().setpoints) if self.goal is None else self.goal
        if self._playback is not None and self._playback.step(now):
            self._set(self._playback.trajectory.positions[-1], now)  # keep this goal until the arm reaches it
        if self.goal is None:
            return True
        _check_takes_targets(self.client)
        joints = self.hardware.joints
        gripper = float(self.goal[-1]) if self.hardware.has_gripper else None
        self.client.write_target(self.goal[:joints], gripper)
        gap = float(np.abs(np.array(self.client.newest().setpoints) - self.goal).max())
        if gap < self._least - _PROGRESS:
            self._least, self._since_s = gap, now
        stuck = now - self._since_s > _STUCK_S
        if gap <= _REACHED or stuck:
            self.goal = None
            self.client.hold()
        return gap <= _REACHED or not stuck


def _check_takes_targets(client: ArmClient) -> None:
    """Raise LifeCycleError, with the reason, if an arm does not accept targets at present."""
    state = client.newest()
    if Limited.PEER in state.limited:
        raise LifeCycleError(f"{client.config.name}: it holds, because the other arm is in trouble; nothing moves")
    if state.mode is Mode.STOPPED:
        raise LifeCycleError(f"{client.config.name}: the emergency stop is latched; nothing moves")
    if state.mode not in (Mode.HOLD, Mode.TRACK):
        raise LifeCycleError(
            f"{client.config.name}: it takes no targets in mode {state.mode.name.lower()}; let it hold first"
        )


class Replay:
    """Replay of a recorded motion, with an approach to the motion's first pose.

    Args:
        clients: clients of the arms; floating arms are made to hold.
        trajectory: motion with a column for each motor of the arms.
        now: time of the arms' clock, s.

    Attributes:
        paused: whether the motion is to slow to rest and stay there.
        share: fraction of the motion completed, 0 … 1.

    Raises:
        ActionError: the trajectory does not match these arms. Nothing moves.
        YamError: an arm is in fault or silent.
    """

    def __init__(self, clients: Sequence[ArmClient], trajectory: Trajectory, now: float):
        self._playback = replay(clients, trajectory)
        self._then_s, self._place_s, self._rate = now, 0.0, 1.0
        self._ended_s: float | None = None
        self._there = False  # whether the arms were at the motion's end in the previous step
        self.paused, self.share = False, 0.0

    def step(self, now: float) -> bool:
        """Send the current targets. Return True when the arms have reached the last targets, or after a timeout.

        Raises:
            YamError: an arm does not accept targets, is in fault or silent.
        """
        passed_s, self._then_s = min(now - self._then_s, _LONGEST_S), now
        most = passed_s / _RAMP_S
        self._rate += float(np.clip((0.0 if self.paused else 1.0) - self._rate, -most, most))
        self._place_s += self._rate * passed_s
        self.share = min(self._place_s / self._playback.trajectory.seconds, 1.0)
        if not self._playback.step(self._place_s):
            return False
        self._ended_s = now if self._ended_s is None else self._ended_s
        # The end must be reached in two successive steps: in a single step the set-point may just be passing the end.
        there, self._there = self._there, not self.late()
        return (there and self._there) or now - self._ended_s > _SETTLES_S

    def late(self) -> str:
        """Return the name of an arm and joint that is not at the motion's end, or "" if all joints are there."""
        return self._playback.late()


class HeldBack:
    """Search for the parts because of which the collision guard holds an arm back. Use it from one thread only.

    `arms`: arms of one session, in the order of all lists below.
    """

    def __init__(self, arms: Sequence[ResolvedArm]):
        self._joints = [arm.joints for arm in arms]
        self._clearance = Clearance(
            [GuardedArm(arm.name, arm.arm, arm.gripper, arm.config.workspace, arm.tilt_rad) for arm in arms]
        )

    def reason(
        self, arm: int, setpoints: Sequence[np.ndarray], goals: Sequence[np.ndarray], openings: Sequence[float]
    ) -> str:
        """Return the pairs of parts that hold an arm back, such as "left link4 – left link1, 21 mm"; "" without any.

        The distance is the present one, before the motion.

        Args:
            arm: index of the arm.
            setpoints, goals: set-points and goals of each arm, rad, (joints,) or more.
            openings: gripper opening of each arm, 0 closed … 1 open.
        """
        parts = self._clearance.parts
        parts.open_grippers(openings)
        start, goal = (
            np.concatenate([row[:n] for row, n in zip(rows, self._joints, strict=True)]) for rows in (setpoints, goals)
        )
        way = goal - start
        way *= min(1.0, _AHEAD_RAD / max(float(np.abs(way).max(initial=0.0)), 1e-9))
        found: dict[str, None] = {}
        for conflict in self._clearance.conflicts(start, start + way):
            if arm in conflict.pair.arms:
                first, second = (parts.part_names[part] for part in conflict.pair[:2])
                found.setdefault(f"{first} – {second}, {conflict.before_m * 1000:.0f} mm")
        return "; ".join(found)
