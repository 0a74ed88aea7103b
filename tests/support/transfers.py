"""Counts transfers of a rig's props in its own process (`RigOperations.load`), as events of the rig.

In a transfer a prop leaves the table, rises by at least `LIFT_M`, and comes to rest at least `CARRY_M` away, in no
gripper. A cycle is a chain of transfers that brings it from one end place to the other.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.judge import FALL_M, REST_SPEED_M_S, Contacts
from lerobot_robot_yam.rig.world.world import World

LIFT_M = 0.05
CARRY_M = 0.15
ENDS = ("A", "B")  # places between which a cycle runs
_AIRBORNE_M = 0.01
_REST_S = 0.2
_PLACE_RADIUS_M = 0.08
_STEP_S = 0.004  # a shorter one does not tell a speed

Point = tuple[float, ...]


def install(device: RigDevice) -> None:
    """Log the transfers of a rig's props from now on."""
    transfers, seen = AllTransfers(device.world), device.events.next_number

    def look() -> None:
        nonlocal seen
        if device.events.next_number > seen:
            for event in device.events.since(seen):
                if event["kind"] in ("placed", "task_placed"):
                    transfers.reset(event.get("prop"))
            seen = device.events.next_number
        for event in transfers.update(device.clock.now()):
            device.events.add(event.pop("kind"), **event)
            seen = device.events.next_number

    device.each_advance.append(look)


class AllTransfers:
    """Follows the props of a world between its scene's places."""

    def __init__(self, world: World):
        self._world, self._contacts = world, Contacts(world)
        places = {name: point[:2].tolist() for name, point in (world.scene.places or {}).items()}
        self._props = {thing.name: Transfers(thing.name, places) for thing in world.scene.props}

    def reset(self, prop: str | None) -> None:
        """A prop (None: each) was put somewhere: that is no transfer."""
        for name, transfers in self._props.items():
            if prop in (None, name):
                transfers.reset()

    def update(self, now_s: float) -> list[dict[str, Any]]:
        """The events of `Transfers.update` of all props at a time of the clock."""
        world, events = self._world, []
        for name, transfers in self._props.items():
            position = world.data.body(name).xpos.tolist()
            events += transfers.update(world.sim_s, now_s, position, lambda n=name: bool(self._contacts.look()[1][n]))
        return events


class Transfers:
    """Follows one prop.

    Args:
        prop: its name, as in the events.
        places: name → (x, y) in m; names the ends of a transfer.
    """

    def __init__(self, prop: str, places: Mapping[str, Sequence[float]]):
        self._prop = prop
        self._places = {name: (float(xy[0]), float(xy[1])) for name, xy in places.items()}
        self.reset()

    def reset(self) -> None:
        """The prop was put somewhere: what was under way does not count."""
        self._last: tuple[float, Point] | None = None
        self._rest: Point | None = None  # where it last lay still
        self._still_since: float | None = None
        self._moving: dict[str, Any] | None = None
        self._cycle: dict[str, Any] | None = None  # the start of the cycle under way
        self._fallen = False

    def update(
        self, time_s: float, wall_s: float, position_m: Sequence[float], held: Callable[[], bool]
    ) -> list[dict[str, Any]]:
        """Take the prop's centre (3,) at a simulated and a monotonic time; return the events that this completes.

        `held`: says whether an arm's fingers are closed on it; asked only where that matters.

        Events carry `kind` ("transfer", "drop", "cycle" or "fall"), `prop`, `start` and `end` as
        {"sim_s", "monotonic_s"}, and for the first three `lift_m`, `carry_m`, `from`, `to` ({"place", "xy_m"}).
        A "drop" is a prop that came down again without having been lifted and carried far enough.
        """
        position = tuple(position_m)
        if self._last is None:
            self._last = (time_s, position)
            return []
        last_s, last = self._last
        if time_s - last_s < _STEP_S:
            return []
        self._last = (time_s, position)
        now = {"sim_s": round(time_s, 4), "monotonic_s": round(wall_s, 4)}
        speed = math.dist(position, last) / (time_s - last_s)
        if position[2] < FALL_M:
            if self._fallen:
                return []
            start = self._moving["start"] if self._moving else now
            self.reset()
            self._fallen = True
            return [{"kind": "fall", "prop": self._prop, "start": start, "end": now}]
        self._fallen = False
        if speed >= REST_SPEED_M_S or (self._moving is not None and held()):
            self._still_since = None
        elif self._still_since is None:
            self._still_since = time_s
        still = self._still_since is not None and time_s - self._still_since >= _REST_S
        if self._moving is None:
            if self._rest is not None and position[2] - self._rest[2] > _AIRBORNE_M:
                # Carrying counts from where it left the table: pushing it along the table does not.
                self._moving = {"start": now, "from": (*position[:2], self._rest[2]), "lift_m": 0.0}
            elif still:
                self._rest = position
            return []
        self._moving["lift_m"] = max(self._moving["lift_m"], position[2] - self._moving["from"][2])
        if not still or position[2] - self._moving["from"][2] > _AIRBORNE_M:
            return []
        moving, self._moving, self._rest = self._moving, None, position
        return self._settled(moving, position, now)

    def _settled(self, moving: dict[str, Any], position: Point, now: dict[str, float]) -> list[dict[str, Any]]:
        good = moving["lift_m"] >= LIFT_M and math.dist(position[:2], moving["from"][:2]) >= CARRY_M
        events = [self._event("transfer" if good else "drop", moving, position, now)]
        if not good:
            self._cycle = None
            return events
        if self._place_of(moving["from"]) in ENDS:
            self._cycle = dict(moving)
        if self._cycle is not None:
            self._cycle["lift_m"] = min(self._cycle["lift_m"], moving["lift_m"])
            if {self._place_of(self._cycle["from"]), self._place_of(position)} == set(ENDS):
                events.append(self._event("cycle", self._cycle, position, now))
                self._cycle = None
        return events

    def _event(self, kind: str, moving: dict[str, Any], end: Point, now: dict[str, float]) -> dict[str, Any]:
        def where(position: Point) -> dict[str, Any]:
            return {"place": self._place_of(position), "xy_m": [round(v, 4) for v in position[:2]]}

        return {
            "kind": kind,
            "prop": self._prop,
            "lift_m": round(moving["lift_m"], 4),
            "carry_m": round(math.dist(end[:2], moving["from"][:2]), 4),
            "from": where(moving["from"]),
            "to": where(end),
            "start": moving["start"],
            "end": now,
        }

    def _place_of(self, position_m: Sequence[float]) -> str | None:
        """Name of the place where the prop lies, or None."""
        near = (name for name, xy in self._places.items() if math.dist(position_m[:2], xy) < _PLACE_RADIUS_M)
        return next(near, None)
