"""Ways through poses that tell an arm's weight and friction, clear of the table and of the arm itself.

The next pose is always the one, of some random ones, whose way adds most to what the data will tell: the largest
growth of the determinant of the information (D-optimal design), per second of the way.
"""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.collision.clearance import Clearance, Conflict
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.tuning.gravity_terms import GravityTerms
from lerobot_robot_yam.errors import ConfigError

SPEED_RAD_S = 0.55  # the most of any joint; slow, so that inertia hardly counts, and friction is more than the noise
MARGIN_M = 0.03  # from the table and from itself: as much as the tool sags while the weight is unknown
RAMP_S = 0.3  # from rest to full speed
WAIT_S = 0.5  # at each pose
_TURN_RAD = 0.6  # of the base to either side, from where it stands
_FROM_STOPS_RAD = 0.1
_MOVED_RAD = 0.25  # least of each joint on a way: it shows its friction
_CANDIDATES = 60
_TRIES = 5  # sets of candidates until a way is clear
_LOOKS = 200  # along a way
_POINTS = np.linspace(0.1, 0.9, 5)  # of a way, at which its information is judged
_WEAK = 1e-3  # information, (kg m)⁻² and the like, to begin with


class Route:
    """Tells which straight ways of an arm are clear.

    Args:
        hardware: the arm.
        workspace: floor, boxes and margin that it keeps.
    """

    def __init__(self, hardware: ResolvedArm, workspace: WorkspaceConfig):
        arm = GuardedArm(hardware.name, hardware.arm, hardware.gripper, workspace, hardware.tilt_rad)
        self._clearance = Clearance([arm])
        self._name = hardware.name

    def conflict(self, start: np.ndarray, end: np.ndarray) -> Conflict | None:
        """The worst conflict on the way between two poses (n,) rad, None where it is clear."""
        found = self._clearance.conflicts(start, end, most_steps=_LOOKS)
        return found[0] if found else None

    def check(self, poses: Sequence[np.ndarray]) -> None:
        """Refuse a way through poses (n,) rad that hits something. Raises ConfigError: says where, and what."""
        names = self._clearance.parts.part_names
        for number, (start, end) in enumerate(zip(poses, poses[1:], strict=False), 1):
            if (found := self.conflict(start, end)) is not None:
                first, second = names[found.pair.first], names[found.pair.second]
                raise ConfigError(
                    f"{self._name}: on the way to pose {number} {first} would come within "
                    f"{max(found.there_m, 0.0) * 1e3:.0f} mm of {second} ({shown(end)}); leave that pose out, or "
                    "begin with the arm elsewhere"
                )


def shown(q: np.ndarray) -> str:
    """A pose (n,) rad as a list."""
    return "[" + ", ".join(f"{value:.2f}" for value in q) + "]"


def way_s(start: np.ndarray, end: np.ndarray) -> float:
    """Time of a way at a speed of `SPEED_RAD_S` at most, with `RAMP_S` to speed up and as long to slow down."""
    return float(np.abs(end - start).max()) / SPEED_RAD_S + RAMP_S


def information(terms: GravityTerms, way: np.ndarray, steps_nm: np.ndarray) -> np.ndarray:
    """(p, p) that a way (k, n) rad tells about the moments, in units of the steps of the measured torques (n,) Nm."""
    rows = [terms.moments(q) / steps_nm[:, None] for q in way]
    return np.sum([row.T @ row for row in rows], axis=0)


def plan(
    hardware: ResolvedArm, terms: GravityTerms, route: Route, start: np.ndarray, steps_nm: np.ndarray, legs: int
) -> np.ndarray:
    """Poses (legs + 1, n) rad of a way for an arm that lies or stands at `start` (n,) rad.

    Raises:
        ConfigError: no way is clear.
    """
    random = np.random.default_rng(0)
    low, high = (hardware.arm.joint_limits_rad + [_FROM_STOPS_RAD, -_FROM_STOPS_RAD]).T
    base = hardware.folding.base
    if base is not None:
        low[base], high[base] = max(low[base], start[base] - _TURN_RAD), min(high[base], start[base] + _TURN_RAD)
    known = _WEAK * np.eye(len(terms.terms))
    poses = [start]
    while len(poses) < legs + 2:
        for _ in range(_TRIES):
            candidates = random.uniform(low, high, (_CANDIDATES, len(low)))
            if (found := _best(candidates, poses[-1], terms, route, steps_nm, known)) is not None:
                break
        else:
            raise ConfigError(
                f"{hardware.name}: no pose can be reached from {shown(poses[-1])} without coming within "
                f"{MARGIN_M * 1e3:.0f} mm of the table or of the arm itself; begin with the arm elsewhere"
            )
        poses.append(found[0])
        known = known + found[1]
    return np.array(poses[1:])


def _best(
    candidates: np.ndarray, here: np.ndarray, terms: GravityTerms, route: Route, steps_nm: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The one of the candidates (c, n) rad with a clear way that tells most, and what it tells; None: no way is."""
    least = np.linalg.slogdet(known)[1]
    scored = []
    for there in candidates:
        if np.abs(there - here).min() >= _MOVED_RAD:
            told = information(terms, here + _POINTS[:, None] * (there - here), steps_nm)
            gain = (np.linalg.slogdet(known + told)[1] - least) / (way_s(here, there) + WAIT_S)
            scored.append((gain, there, told))
    for _, there, told in sorted(scored, key=lambda row: -row[0]):
        if route.conflict(here, there) is None:
            return there, told
    return None
