"""Touches of props in the world: by things, by arms, and by an arm's two fingers."""

from collections.abc import Mapping

import numpy as np

from lerobot_robot_yam.rig.world.world import World

Touches = Mapping[str, frozenset[str]]
"""Prop → what touches it."""


class Contacts:
    """Touches of the scene's props, as of the last step."""

    def __init__(self, world: World):
        model = world.model
        self._data = world.data
        self._props = {model.body(thing.name).id: thing.name for thing in world.scene.props}
        self._bodies: np.ndarray = model.geom_bodyid
        self._names = [model.body(body).name for body in range(model.nbody)]
        owners = {body: name.partition("/")[0] for body, name in enumerate(self._names)}
        self._arms = {body: owner for body, owner in owners.items() if owner in world.profiles}
        self._fingers: dict[int, int] = {}  # body → number of the finger
        for channel, (_, gripper) in world.profiles.items():
            for number, name in enumerate(gripper.finger_joints):
                self._fingers[int(model.joint(f"{channel}/{name}").bodyid[0])] = number

    def look(self) -> tuple[Touches, Touches]:
        """For each prop the channels, things and "world" that touch it, and the channels whose two fingers both do."""
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
