"""Checks of an episode's actions and measured states. Angles are in rad, even if the data set is in degrees."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.config import ARMS
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.face.datasets.check.flags import Flag, Kind
from lerobot_robot_yam.face.datasets.layout import value_names
from lerobot_robot_yam.face.devices.feature_names import JOINT

JUMP_RAD_S = 5.0  # speed over a whole frame from which a motion is a jump, rad/s: faster than any hand
JUMP_RAD = (0.3, 0.45)  # minimum and maximum of the jump threshold per frame, rad, at any frame rate
LIMIT_SLACK_RAD = 0.1  # distance outside the joint limits that is tolerated, rad
OPENING = (-0.05, 1.05)  # range of plausible gripper openings
STILL_S = 0.5  # minimum duration of a flagged standstill, s
LAG_S = 0.25  # delay of a healthy arm behind its action, s
# ACTION_MOVES_RAD: motion of the action that flags a frozen state, rad; STATE_LEAVES_RAD: the reverse
ACTION_MOVES_RAD, STATE_LEAVES_RAD = 0.1, 0.2
FAR_RAD = 0.35  # median distance between joint and action from which they are flagged as far apart, rad
# distance from the action, rad, at which an approach begins (AWAY_RAD) and ends (THERE_RAD)
AWAY_RAD, THERE_RAD = 0.3, 0.15
LARGEST_RAD = 6.4  # angle that is beyond any joint's range in rad, but small in degrees
MOVES_RAD = 0.3  # motion, in recorded units, from which small numbers in a data set of degrees are taken for radians


@dataclass(frozen=True)
class ArmMotion:
    """Motion of one arm's joints in an episode.

    prefix: start of the joints' names, such as `left_`. action, state: (n, joints) rad.
    """

    prefix: str
    action: np.ndarray
    state: np.ndarray

    def says(self, text: str) -> str:
        """Return `text`, preceded by the arm's name if there are two arms."""
        return f"{self.prefix.rstrip('_')}: {text}" if self.prefix else text


def arms_of(
    action: np.ndarray,
    state: np.ndarray,
    action_feature: Mapping[str, Any],
    state_feature: Mapping[str, Any],
    unit: float,
) -> list[ArmMotion]:
    """Return the motion of each arm whose joints have this package's names in both action and state.

    Args:
        action, state: (n, values) as recorded.
        action_feature, state_feature: LeRobot's descriptions, with names.
        unit: rad per recorded unit.
    """
    given, measured = list(value_names(action_feature)), list(value_names(state_feature))
    found = []
    for prefix in sorted({match[1] or "" for match in map(JOINT.fullmatch, given) if match}):
        joints = [name for name in given if (match := JOINT.fullmatch(name)) and (match[1] or "") == prefix]
        if set(joints) <= set(measured):
            columns = [measured.index(name) for name in joints]
            found.append(
                ArmMotion(prefix, action[:, [given.index(name) for name in joints]] * unit, state[:, columns] * unit)
            )
    return found


def joint_limits(arm: str | None, joints: int) -> np.ndarray | None:
    """Return a profile's limits (joints, 2) rad; without a name, the widest limits of all arms with `joints` joints.

    Raises:
        ConfigError: the arm is unknown.
    """
    profiles = [load_arm(name) for name in ([arm] if arm else ARMS)]
    limits = [profile.joint_limits_rad for profile in profiles if profile.joint_count == joints and joints]
    if not limits:
        return None
    return np.stack([np.min(limits, axis=0)[:, 0], np.max(limits, axis=0)[:, 1]], axis=1)


def runs(mask: np.ndarray, shortest: float) -> list[tuple[int, int]]:
    """Return (first, last + 1) of each run of at least `shortest` true entries."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= shortest]


def _still(values: np.ndarray) -> np.ndarray:
    """Return (n - 1,) whether each row of `values` (n, k) equals the next row, to the last bit."""
    return np.asarray((np.diff(values, axis=0) == 0).all(axis=1))


def finite(feature: str, values: np.ndarray) -> Iterator[Flag]:
    """Flag NaN or infinity in `values` (n, k)."""
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        at = np.flatnonzero(bad)
        yield Flag(Kind.NOT_FINITE, f"{feature} of {len(at)} frames is no number", (int(at[0]), int(at[-1])))


def units(arms: Sequence[ArmMotion], degrees: bool) -> Iterator[Flag]:
    """Flag values whose unit differs from that of the robot's name. degrees: whether the name says degrees."""
    for arm in arms:
        both = np.concatenate([arm.action, arm.state], axis=1)
        largest = np.abs(both).max(axis=1)
        if not degrees and np.median(largest) > LARGEST_RAD:
            yield Flag(
                Kind.UNITS, arm.says(f"joints up to {largest.max():.0f}, as of degrees, in a data set of radians")
            )
        recorded = np.degrees(both)
        if degrees and np.abs(recorded).max() < LARGEST_RAD / 2 and np.ptp(recorded, axis=0).max() > MOVES_RAD:
            text = f"no joint beyond {np.abs(recorded).max():.1f}, as of radians, in a data set of degrees"
            yield Flag(Kind.UNITS, arm.says(text))


def jumps(arm: ArmMotion, fps: float) -> Iterator[Flag]:
    """Flag joints that jump from one frame to the next."""
    limit = float(np.clip(JUMP_RAD_S / fps, *JUMP_RAD))
    for kind, what, q in ((Kind.ACTION_JUMP, "the action", arm.action), (Kind.STATE_JUMP, "the arm", arm.state)):
        steps = np.abs(np.diff(q, axis=0))
        if steps.size and steps.max() > limit:
            at = np.flatnonzero(steps.max(axis=1) > limit)
            joint = int(np.argmax(steps.max(axis=0))) + 1
            text = f"joint {joint} of {what} jumps by {steps.max():.2f} rad; {len(at)} jumps in all"
            yield Flag(kind, arm.says(text), (int(at[0]), int(at[-1]) + 1))


def limits(arm: ArmMotion, limits_rad: np.ndarray | None) -> Iterator[Flag]:
    """Flag measured joints outside the limits (joints, 2)."""
    if limits_rad is None or len(limits_rad) != arm.state.shape[1]:
        return
    beyond = np.maximum(limits_rad[:, 0] - arm.state, arm.state - limits_rad[:, 1])
    if beyond.max() > LIMIT_SLACK_RAD:
        bad = np.flatnonzero(beyond.max(axis=1) > LIMIT_SLACK_RAD)
        text = f"joint {int(np.argmax(beyond.max(axis=0))) + 1} is {beyond.max():.2f} rad outside its limits"
        yield Flag(Kind.JOINT_LIMITS, arm.says(text), (int(bad[0]), int(bad[-1])))


def grippers(feature: str, values: np.ndarray, names: Sequence[str]) -> Iterator[Flag]:
    """Flag gripper openings out of range in `values` (n, k), whose columns have these names."""
    for column in [i for i, name in enumerate(names) if name.endswith("gripper.pos")]:
        low, high = float(values[:, column].min()), float(values[:, column].max())
        if low < OPENING[0] or high > OPENING[1]:
            yield Flag(Kind.GRIPPER_RANGE, f"{names[column]} of {feature} goes from {low:.2f} to {high:.2f}")


def constant(action: np.ndarray, fps: float) -> Iterator[Flag]:
    """Flag an action (n, k) that never changes."""
    if len(action) >= STILL_S * fps and not np.ptp(action, axis=0).any():
        yield Flag(Kind.ACTION_CONSTANT, f"it is the same in all {len(action)} frames")


def frozen(arm: ArmMotion, fps: float) -> Iterator[Flag]:
    """Flag intervals in which action or state is constant, to the last bit, while the other moves."""
    least, lag = max(STILL_S * fps, 3), round(LAG_S * fps)
    for start, stop in runs(_still(arm.state), least):
        moved = float(np.ptp(arm.action[start : stop + 1 - lag], axis=0).max())
        if moved > ACTION_MOVES_RAD:
            text = f"the state stands still while the action moves by {moved:.2f} rad"
            yield Flag(Kind.STATE_FROZEN, arm.says(text), (start, stop))
            break
    gap = np.abs(arm.state - arm.action)
    for start, stop in runs(_still(arm.action), least):
        left = float((gap[stop] - gap[start]).max())
        if left > STATE_LEAVES_RAD:
            text = f"the action stands still while the arm moves {left:.2f} rad away from it"
            yield Flag(Kind.ACTION_FROZEN, arm.says(text), (start, stop))
            break


def apart(arms: Sequence[ArmMotion], fps: float) -> Iterator[Flag]:
    """Flag states far from their actions: swapped arms, joints far apart, an approach at the start."""
    if len(arms) == 2 and arms[0].action.shape == arms[1].action.shape:
        own = sum(float(np.abs(arm.action - arm.state).mean()) for arm in arms) / 2
        crossed = sum(float(np.abs(a.action - b.state).mean()) for a, b in (arms, arms[::-1])) / 2
        if own > 0.05 and crossed < 0.3 * own:
            text = f"the state is {own:.2f} rad away from its arm's action, {crossed:.2f} from the other's"
            yield Flag(Kind.ARMS_SWAPPED, text)
            return
    for arm in arms:
        gap = np.abs(arm.action - arm.state)
        usual = np.median(gap, axis=0)
        if usual.max() > FAR_RAD:
            text = f"joint {int(np.argmax(usual)) + 1} is {usual.max():.2f} rad away from its action most of the time"
            yield Flag(Kind.FAR_APART, arm.says(text))
            continue
        arrived = int(np.argmax(gap.max(axis=1) < THERE_RAD))
        if gap[0].max() > AWAY_RAD and arrived > LAG_S * fps:
            text = f"joint {int(np.argmax(gap[0])) + 1} begins {gap[0].max():.2f} rad away from its action"
            yield Flag(Kind.APPROACH, arm.says(text), (0, arrived - 1))
