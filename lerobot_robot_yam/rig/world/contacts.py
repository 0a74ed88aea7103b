"""Who touches a prop: other things, or which arm, and whether with both fingers; from the world's contacts."""

from collections.abc import Mapping

import numpy as np

from lerobot_robot_yam.rig.world.world import World

Touches = Mapping[str, frozenset[str]]
"""Prop → what touches it."""


class Contacts:
    """Touches of the scene's props, as of the last step.

    Args:
        world: the physics.
    """

    def __init__(self, world: World):
        model = world.model
        self._data = world.data
        self._props = {model.body(thing.name).id: thing.name for thing in world.scene.props}
        self._bodies: np.ndarray = model.geom_bodyid
        self._arms = {}  # body → channel, of everything that belongs to an arm
        self._fingers: dict[int, int] = {}  # body → number of the finger
        for channel, (_, gripper) in world.profiles.items():
            for body in range(model.nbody):
                if model.body(body).name.startswith(f"{channel}/"):
                    self._arms[body] = channel
            for number, name in enumerate(gripper.finger_joints):
                self._fingers[int(model.joint(f"{channel}/{name}").bodyid[0])] = number
        self._names = [model.body(body).name for body in range(model.nbody)]

    def look(self) -> tuple[Touches, Touches]:
        """What touches each prop: (channels of arms, names of things, "world"; channels whose two fingers both do)."""
        touching: dict[str, set[str]] = {name: set() for name in self._props.values()}
        fingers: dict[str, set[tuple[str, int]]] = {name: set() for name in self._props.values()}
        for body, other in self._pairs():
            prop = self._props[body]
            touching[prop].add(self._arms.get(other) or self._names[other])
            if other in self._fingers:
                fingers[prop].add((self._arms[other], self._fingers[other]))
        held = {
            prop: frozenset(channel for channel, finger in found if finger == 0 and (channel, 1) in found)
            for prop, found in fingers.items()
        }
        return {prop: frozenset(others) for prop, others in touching.items()}, held

    def holds(self, prop: str) -> bool:
        """Whether an arm's two fingers both touch a prop."""
        return bool(self.look()[1][prop])

    def _pairs(self) -> set[tuple[int, int]]:
        """(prop, other body) of every contact of a prop."""
        touching = self._data.contact.dist[: self._data.ncon] <= 0.0
        bodies = self._bodies[self._data.contact.geom[: self._data.ncon][touching]].tolist()
        pairs = {pair for first, second in bodies for pair in ((first, second), (second, first))}
        return {pair for pair in pairs if pair[0] in self._props}
