"""The true state of each motor's shaft in every step of the physics, by which tests judge a driver."""

import bisect
import itertools
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np

from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.world.mechanics import Drive
from lerobot_robot_yam.rig.world.world import World

_STEP_S = 0.001
_Sample = tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class TruthRecorder:
    """Keeps the last seconds of the world, one sample per step, while it is on for any channel.

    Off by default: while it is on, the physics is simulated step by step.
    """

    def __init__(self, world: World, channels: Iterable[Channel]):
        self._world = world
        self._drives: dict[str, list[Drive]] = {
            channel.name: [motor.drive for motor in channel.motors if isinstance(motor.drive, Drive)]
            for channel in channels
        }
        self._all = np.arange(world.model.nu)
        self._seconds: dict[str, float] = {}
        self._since_s: dict[str, float] = {}
        self._kept: deque[_Sample] = deque()

    @property
    def on(self) -> bool:
        """Whether `sample` must be called after each step."""
        return bool(self._seconds)

    def start(self, channel: str, seconds: float) -> None:
        """Keep the last seconds of a channel, from now on and anew."""
        self._seconds[channel], self._since_s[channel] = seconds, self._world.stamp_s
        self._resize()

    def stop(self, channel: str) -> None:
        """Keep nothing of it."""
        self._seconds.pop(channel, None)
        self._resize()

    def _resize(self) -> None:
        longest_s = max(self._seconds.values(), default=0.0)
        self._kept = deque(self._kept, maxlen=round(longest_s / self._world.timestep_s))

    def knows(self, channel: str) -> bool:
        """Whether it is kept."""
        return channel in self._seconds

    def sample(self) -> None:
        """Keep the present state, and the torques of the step before it."""
        if self._seconds:
            world, data = self._world, self._world.data
            state = data.qpos.copy(), data.qvel.copy(), data.actuator_force.copy()
            self._kept.append((world.stamp_s, *state, world.asked_nm(self._all)))

    def report(self, channel: str, after_s: float, limit: int) -> dict[str, Any]:
        """The oldest `limit` samples later than `after_s`, see `RigOperations.truth`."""
        after_s = max(after_s, self._since_s[channel])
        begin = bisect.bisect_right(self._kept, after_s, key=lambda sample: sample[0])
        rows = list(itertools.islice(self._kept, begin, begin + limit))
        if not rows:
            return {"samples": []}
        stamps, qpos, qvel, force, asked = (np.array(column) for column in zip(*rows, strict=True))
        drives = self._drives[channel]
        angles, rates = zip(*(drive.read(qpos, qvel) for drive in drives), strict=True)
        actuators = [drive.actuator for drive in drives]
        columns = (stamps, np.transpose(angles), np.transpose(rates), force[:, actuators], asked[:, actuators])
        return {"samples": [list(row) for row in zip(*(column.tolist() for column in columns), strict=True)]}


def beyond_clip_nm(
    truth: dict[str, np.ndarray], kp: np.ndarray, kd: np.ndarray, clip_nm: np.ndarray, known_s: np.ndarray | float
) -> np.ndarray:
    """The largest torque in Nm that commands asked of each of the first n motors beyond its clip; 0 if all kept to it.

    A command that keeps to the clip by a state of up to `known_s` ago asks for more where the joint has moved since,
    by  kp (q before − q now) + kd (dq before − dq now). No driver can know that. Of those states the one that explains
    a torque best is taken for the one that the driver knew.

    Args:
        truth: of `RigOperations.truth`, steps of 1 ms.
        kp, kd: (n,) gains of the commands, Nm/rad and Nm s/rad.
        clip_nm: (n,) Nm.
        known_s: (n,) or one for all, s.
    """
    n = len(clip_nm)
    q, dq, asked = (truth[key].reshape(len(truth["stamp_s"]), -1)[:, :n] for key in ("q", "dq", "asked_nm"))
    lags = np.broadcast_to(np.round(np.asarray(known_s) / _STEP_S).astype(int), n)
    beyond = np.abs(asked) - clip_nm
    for lag in range(1, min(int(lags.max(initial=0)), len(q) - 1) + 1):
        moved = kp * (q[:-lag] - q[lag:]) + kd * (dq[:-lag] - dq[lag:])
        explained = np.where(lag <= lags, np.abs(asked[lag:] - moved) - clip_nm, np.inf)
        beyond[lag:] = np.minimum(beyond[lag:], explained)
    largest: np.ndarray = beyond.max(axis=0, initial=0.0)
    return largest
