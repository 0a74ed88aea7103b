"""A recorded motion that arms follow: it comes to rest softly when it is paused, and goes on softly."""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.session import playback
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.trajectory import Trajectory

_RAMP_S = 0.4  # from full speed to rest, and back
_SETTLES_S = 1.0  # the set-points come to the last targets at their own speed
_LONGEST_S = 0.1  # of a step: while nobody gives targets, the motion stands still, too


class Replay:
    """A motion on its way, with the way to its first pose before it.

    Args:
        clients: the arms. One that floats holds from now on.
        trajectory: with a column for each of their motors.
        now: by the arms' clock, s.

    Attributes:
        paused: whether it comes to rest, or stands still.
        share: how much of it is done, 0 … 1.

    Raises:
        ActionError: it does not fit these arms; nothing moves.
        YamError: one has failed or is silent.
    """

    def __init__(self, clients: Sequence[ArmClient], trajectory: Trajectory, now: float):
        self._playback = playback.replay(clients, trajectory)
        self._then_s, self._place_s, self._rate = now, 0.0, 1.0
        self._ended_s: float | None = None
        self.paused, self.share = False, 0.0

    def step(self, now: float) -> bool:
        """Give the targets of this moment; True once the arms are at the last ones, or have had time to get there.

        Raises:
            YamError: one takes no targets, has failed or is silent.
        """
        passed_s, self._then_s = min(now - self._then_s, _LONGEST_S), now
        most = passed_s / _RAMP_S
        self._rate += float(np.clip((0.0 if self.paused else 1.0) - self._rate, -most, most))
        self._place_s += self._rate * passed_s
        self.share = min(self._place_s / self._playback.trajectory.seconds, 1.0)
        if not self._playback.step(self._place_s):
            return False
        self._ended_s = now if self._ended_s is None else self._ended_s
        return not self.late() or now - self._ended_s > _SETTLES_S

    def late(self) -> str:
        """The joint, with its arm, that is not where the motion ends; empty when all are."""
        return self._playback.late()
