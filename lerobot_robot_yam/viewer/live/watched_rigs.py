"""The virtual rigs of the arms that are watched: each is found by its arms, and drawn."""

import logging
from collections.abc import Iterable

import viser

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.viewer.drawing.rig_scenery import RigScenery
from lerobot_robot_yam.viewer.live.placement import origin_of
from lerobot_robot_yam.viewer.live.rig_world import RigWorld

logger = logging.getLogger(__name__)


class WatchedRigs:
    """All of them.

    Args:
        server: viser's.

    Attributes:
        worlds: by the rig's name, in the order in which they stand beside each other.
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self.worlds: dict[str, RigWorld] = {}
        self._sceneries: dict[str, RigScenery] = {}
        self._unknown: set[str] = set()  # whose world nobody tells

    def keep(self, names: Iterable[str]) -> bool:
        """Have the rigs of these names, and no other; True: something has changed."""
        wanted = set(names)
        self._unknown &= wanted
        before = list(self.worlds.values())
        for name in [name for name, world in self.worlds.items() if name not in wanted or not world.current]:
            self._forget(name)
        for name in sorted(wanted - self.worlds.keys() - self._unknown):
            try:
                self.worlds[name] = world = RigWorld(name)
            except (YamError, OSError) as error:
                self._unknown.add(name)
                logger.warning("rig %s is not drawn: %s", name, error)
                continue
            self._sceneries[name] = RigScenery(self._server, world, origin_of(len(self._sceneries)))
        return before != list(self.worlds.values())

    def update(self, now_s: float, watched: bool) -> None:
        """Draw what has changed in them. watched: somebody looks."""
        for scenery in self._sceneries.values():
            scenery.update(now_s, watched)

    def cameras(self, now_s: float) -> list[str]:
        """A line for each rendered camera that somebody has opened."""
        return [line for scenery in self._sceneries.values() for line in scenery.cameras(now_s)]

    def _forget(self, name: str) -> None:
        self._sceneries.pop(name).close()
        self.worlds.pop(name).close()

    def close(self) -> None:
        """Let go of all. Idempotent."""
        for name in list(self.worlds):
            self._forget(name)
