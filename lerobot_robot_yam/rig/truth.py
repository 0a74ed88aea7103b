"""What each motor's shaft truly did, step by step of the physics: for tests that compare a driver's states with it."""

from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np

from lerobot_robot_yam.rig.channel import Channel
from lerobot_robot_yam.rig.world import World

Sample = tuple[float, list[float], list[float], list[float], list[float]]


class TruthRecorder:
    """Keeps the last seconds of a channel's shafts: one sample per step, in the order of `Channel.motors`.

    Off by default: while it is on for any channel, the physics goes step by step.
    """

    def __init__(self, world: World, channels: Iterable[Channel]):
        self._world = world
        self._drives = {channel.name: [motor.drive for motor in channel.motors] for channel in channels}
        self._actuators = {name: np.array([d.actuator for d in drives]) for name, drives in self._drives.items()}
        self._kept: dict[str, deque[Sample]] = {}

    @property
    def on(self) -> bool:
        """Whether `sample` must be called after each step."""
        return bool(self._kept)

    def start(self, channel: str, seconds: float) -> None:
        """Keep so much of a channel, from now on and anew."""
        self._kept[channel] = deque(maxlen=max(1, round(seconds / self._world.timestep_s)))

    def stop(self, channel: str) -> None:
        """Keep nothing of it any more."""
        self._kept.pop(channel, None)

    def knows(self, channel: str) -> bool:
        """Whether it is kept."""
        return channel in self._kept

    def sample(self) -> None:
        """Keep the present state, and the torques of the step that led to it."""
        world = self._world
        for channel, kept in self._kept.items():
            drives, actuators = self._drives[channel], self._actuators[channel]
            kept.append(
                (
                    world.stamp_s,
                    [drive.angle() for drive in drives],
                    [drive.velocity() for drive in drives],
                    [drive.torque() for drive in drives],
                    world.asked_nm(actuators).tolist(),
                )
            )

    def report(self, channel: str, after_s: float, limit: int) -> dict[str, Any]:
        """The oldest `limit` samples later than `after_s`, see `control.RigControl.truth`."""
        return {"samples": [sample for sample in self._kept[channel] if sample[0] > after_s][:limit]}
