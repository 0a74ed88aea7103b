"""First phase of a landing: fold the arm above its resting place, avoiding obstacles.

The arm moves straight to the folded pose with the wrist raised. If an obstacle blocks this path, the arm moves over the
top: wrist up and elbow open until the forearm is at least level, upper arm back, forearm down. If both paths are
blocked, the arm holds, logs an error and retries; at the third failure the arm sinks in place.

An arm with a wrong model sags below its set-point. A torque error that a wrong load or factor can explain is learnt;
any other torque error means an obstacle. An unknown load makes the soft wrist sag; a sagging wrist is no obstacle,
since the wrist is lowered next.
"""

import logging

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.landing.landing_move import LandingMove, Patience, Phase, Seen

logger = logging.getLogger(__name__)

_WRIST_LIFT_RAD = 0.35  # wrist lift above the resting pose while the arm folds
_SOFT_RAD = 0.3  # remaining distance below which the fold slows down
_OPEN_RAD = 1.2  # elbow angle with the tool at its highest while the upper arm lies
_AT_POSE_RAD = 0.06  # maximum error of an arm that has arrived
_STUCK_RAD = 0.25  # minimum error of a blocked arm
_STUCK_S = 0.5  # time blocked after which the arm counts as stuck, s
_LEARN_S = 2.0  # time for learning the model's error with the set-point at its goal, s
_RETRY_S = 3.0  # pause before both paths are tried again, s
_TRIES = 3  # failed attempts after which the arm sinks


class Fold:
    """Fold of one landing.

    Args:
        hardware: the arm.
        rest: (n,) rad, resting pose.
        move: mover of the set-point.

    Attributes:
        may_learn: whether the arm may learn a torque that corrects its gravity model.
        gave_up: whether the arm cannot reach its folded pose, so that the landing must end by sinking, not fading.
    """

    def __init__(self, hardware: ResolvedArm, rest: np.ndarray, move: LandingMove):
        self._arm, self._roles, self._rest, self._move = hardware.name, hardware.folding, rest, move
        self._goes_over = hardware.lies_at_rest
        self._pose = rest.copy()
        wrist = self._roles.wrist
        if wrist is not None:
            self._up = float(np.copysign(1.0, -rest[wrist]))  # direction that raises the wrist
            self._pose[wrist] += self._up * _WRIST_LIFT_RAD
        self._poses: list[np.ndarray] = []  # remaining poses
        self._patience = Patience()
        self._goes_round = self.may_learn = self.gave_up = False
        self._barred_times, self._barred_s = 0, 0.0

    def begin(self, now: float) -> None:
        """Begin the straight path."""
        self._go([self._pose], now)

    def advance(self, seen: Seen) -> Phase:
        """Advance by one tick; return the next phase: LOWER once the arm is folded."""
        move, now = self._move, seen.now
        if np.abs(move.way).max() < _SOFT_RAD:
            move.soften()
        error = np.where(seen.usable, np.abs(move.q - seen.q), 0.0)
        wrist = self._roles.wrist
        if wrist is not None and 0.0 < self._up * (move.q[wrist] - seen.q[wrist]) < move.sag_rad[wrist]:
            error[wrist] = 0.0
        farthest, arrived = error.max(), move.arrived
        if self._poses and arrived and farthest < _STUCK_RAD:
            move.begin(self._poses.pop(0), now)
        elif arrived and farthest < _AT_POSE_RAD:
            return Phase.LOWER
        elif arrived and seen.explained and farthest < _STUCK_RAD:
            self.may_learn = True
            if self._patience.ends(True, now, _LEARN_S):
                self.gave_up = True
                return Phase.LOWER
        elif self._patience.ends(farthest > _STUCK_RAD or arrived, now, _STUCK_S):
            move.give_way(move.near(move.q, seen.q), seen.usable)
            return self._barred(f"joint_{int(error.argmax()) + 1} is held, obstructed or carries too much", now)
        return Phase.FOLD

    def retry(self, now: float) -> Phase:
        """Advance by one tick while the arm holds, obstructed: fold again after `_RETRY_S`. Return the next phase."""
        if not now - self._barred_s > _RETRY_S:
            return Phase.OBSTRUCTED
        self._goes_round, self.may_learn = False, True
        return self._go([self._pose], now)

    def _barred(self, reason: str, now: float) -> Phase:
        """Try the path over the top; if that fails too, hold. Sink if a supporting motor is out or all tries failed."""
        out, over = self.carriers(self._move.unheard), self._over_the_top()
        if over and not self._goes_round:
            self._goes_round = True
            text = "%s: on its way down %s; let go of it and keep clear: it goes round, over the top"
            logger.warning(text, self._arm, reason)
            return self._go(over, now)
        if out and self._poses:  # an obstacle on the way up cannot support the arm
            return self._go([self._pose], now)
        if out:
            logger.warning("%s: %s, and %s is out; it sinks where it is", self._arm, reason, ", ".join(out))
            self.gave_up = True
            return Phase.SINK
        if self._barred_times + 1 < _TRIES:
            self._barred_times += 1
            self._barred_s = now
            text = "%s: cannot land, %s; holding. Let go of it, free the way or take the load, and keep clear: "
            text += "it tries again"
            logger.error(text, self._arm, reason)
            return Phase.OBSTRUCTED
        logger.error("%s: cannot land, %s; it sinks slowly where it is", self._arm, reason)
        self.gave_up = True
        return Phase.SINK

    def carriers(self, out: np.ndarray) -> list[str]:
        """Return the names of joints that support the arm and whose motors are `out`, (n,) bool: limp or silent."""
        base, first, _, last = self._roles
        carriers = range(len(out)) if first is None or last is None else range(first, last + 1)
        return [f"joint_{joint + 1}" for joint in carriers if out[joint] and joint != base]

    def _over_the_top(self) -> list[np.ndarray]:
        """Return the poses (n,) of the path over the top; empty for arms that do not lie at rest or lack an elbow."""
        _, shoulder, elbow, wrist = self._roles
        if not self._goes_over or shoulder is None or elbow is None:
            return []
        level = self._move.q.copy()
        if wrist is not None:
            level[wrist] = self._pose[wrist]
        open_rad = max(_OPEN_RAD, level[shoulder] - self._rest[shoulder])
        level[elbow] = max(level[elbow], self._rest[elbow] + open_rad)
        back = level.copy()
        back[shoulder], back[elbow] = self._rest[shoulder], self._rest[elbow] + _OPEN_RAD
        return [level, back, self._pose]

    def _go(self, poses: list[np.ndarray], now: float) -> Phase:
        self._patience = Patience()
        first, *self._poses = poses
        self._move.begin(first, now)
        return Phase.FOLD
