"""Moving leaders by hand along paths, while watching whether their followers come along.

Clock and world come in through `Hands`. So the same code runs on a live rig and on a simulation faster than time.
"""

import logging
from collections.abc import Iterable
from typing import Protocol

import numpy as np

from lerobot_robot_yam.rig.operator.plan import Path, minimum_jerk
from lerobot_robot_yam.rig.operator.sight import Sight

logger = logging.getLogger(__name__)

_LOOK_S = 0.05
_LAG_RAD = 0.35  # a follower further behind than this for _STALL_S does not follow
_STALL_S = 0.4
_ARRIVED_RAD = 0.05
_STILL_RAD = 0.004  # between two looks
_SETTLE_S = 0.8
_PATIENCE_S = 20.0
_TRIGGER_S = 0.3
_FINGERS_REST = 0.01  # of the stroke, between two looks


class Hands(Protocol):
    """The operator's eyes, hands and clock."""

    def now(self) -> float: ...

    def wait(self, seconds: float) -> None: ...

    def look(self) -> Sight: ...

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        """Pull the leader of a side along (k, n) joints at times from now (k,), with trigger 0 … 1 (squeezed) (k,)."""

    def let_go(self) -> None: ...

    def put_back(self, position_m: np.ndarray) -> None: ...


class Interrupted(Exception):  # noqa: N818 - not an error: the session ended
    """The arms are switched off, or go their own way."""


class Guide:
    """Both hands. A path that is sent begins when the hand's last one has ended.

    Attributes:
        q: where each hand is, or will be at the end of its path, (n,) per side.
        trigger: how far each hand squeezes, 0 … 1.

    Every method may raise Interrupted.
    """

    def __init__(self, hands: Hands, sides: Iterable[str]):
        self._hands = hands
        self.q: dict[str, np.ndarray] = {}
        self.trigger = dict.fromkeys(sides, 0.0)
        self._paths: dict[str, tuple[float, Path]] = {}  # start time and path of each hand

    def forget(self) -> None:
        """The hands are off: no path is under way, no trigger squeezed."""
        self._paths.clear()
        self.trigger = dict.fromkeys(self.trigger, 0.0)

    def stop(self, side: str) -> None:
        """Give up the rest of a path: the hand's next path begins where it is now."""
        begun, path = self._paths.pop(side)
        self.q[side] = path.at(self._hands.now() - begun)

    def squeeze(self, side: str, trigger: float) -> None:
        """Move the trigger, and wait until the fingers have come to rest: closed on something, or open."""
        start, self.trigger[side] = self.trigger[side], trigger
        times = np.linspace(0.0, _TRIGGER_S, 9)
        squeeze = start + (trigger - start) * minimum_jerk(times / _TRIGGER_S)
        self._hands.pull(side, times, np.stack([self.q[side]] * len(times)), squeeze)
        opening = self.pause(_TRIGGER_S).opening[side]
        deadline = self._hands.now() + _SETTLE_S
        while self._hands.now() < deadline:
            before, opening = opening, self.pause(2 * _LOOK_S).opening[side]
            if abs(opening - before) < _FINGERS_REST:
                return

    def send(self, side: str, path: Path) -> None:
        """Start a path, after the end of the one that this hand is still on."""
        self.follow_to_end(side)
        self.q[side] = path.end_rad
        self._start(side, path)

    def _start(self, side: str, path: Path) -> None:
        self._paths[side] = (self._hands.now(), path)
        trigger = np.full(len(path.times_s), self.trigger[side])
        self._hands.pull(side, path.times_s, path.q_rad, trigger)

    def follow_to_end(self, side: str) -> None:
        """Wait for the end of a hand's path, if it is on one."""
        if side in self._paths:
            self.follow(side, self._paths[side][1].duration_s)

    def follow(self, side: str, until_s: float) -> None:
        """Wait until a hand is until_s into its path; wait there for a follower that stays behind."""
        behind_since = None
        ending = self._paths[side][1].duration_s - until_s
        while True:
            begun, path = self._paths[side]
            left = path.duration_s - ending - (self._hands.now() - begun)
            if left <= 1e-3:
                return
            sight = self.pause(min(_LOOK_S, left))
            elapsed = self._hands.now() - begun
            if _distance(sight.follower_rad[side], path.at(elapsed)) < _LAG_RAD:
                behind_since = None
                continue
            behind_since = self._hands.now() if behind_since is None else behind_since
            if self._hands.now() - behind_since > _STALL_S:
                self._wait_for_follower(side, path.at(elapsed))
                self._start(side, path.rest(elapsed))
                behind_since = None

    def _wait_for_follower(self, side: str, q_rad: np.ndarray) -> None:
        """Hold still until the follower, which is not driven or was stopped, has come."""
        logger.info("the %s follower does not follow; waiting for it", side)
        self._start(side, Path(np.array([0.0, 0.1]), np.stack([q_rad, q_rad])))
        deadline = self._hands.now() + _PATIENCE_S
        while _distance(self.pause(_LOOK_S).follower_rad[side], q_rad) > 2 * _ARRIVED_RAD:
            if self._hands.now() > deadline:
                logger.info("the %s follower is stuck; going on", side)
                return

    def settle(self, side: str) -> None:
        """Let the follower arrive where the hand is and come to rest; wait for it if it does not."""
        deadline = self._hands.now() + _SETTLE_S
        before = self.see().follower_rad[side]
        while self._hands.now() < deadline:
            after = self.pause(_LOOK_S).follower_rad[side]
            if _distance(after, self.q[side]) < _ARRIVED_RAD and _distance(after, before) < _STILL_RAD:
                return
            before = after
        if _distance(before, self.q[side]) > 2 * _ARRIVED_RAD:
            self._wait_for_follower(side, self.q[side])

    def pause(self, seconds: float) -> Sight:
        """Wait, then look."""
        self._hands.wait(max(0.0, seconds))
        return self.see()

    def see(self) -> Sight:
        """Look.

        Raises:
            Interrupted: the arms are switched off, or have begun to go their own way. The hands have let go.
        """
        sight = self._hands.look()
        if not sight.willing:
            self._hands.let_go()
            raise Interrupted
        return sight


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(np.asarray(a) - b).max())
