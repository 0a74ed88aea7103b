"""Counts transfers of a rig's props in its own process (`RigOperations.load`), as events of the rig.

In a transfer a prop leaves the table, rises by at least `LIFT_M`, and comes to rest at least `CARRY_M` away, in no
gripper. Less than that is a drop.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.judge import REST_SPEED_M_S, Contacts
from lerobot_robot_yam.rig.world.world import World

LIFT_M = 0.05
CARRY_M = 0.15
_AIRBORNE_M = 0.01
_REST_S = 0.2
_PLACE_RADIUS_M = 0.08


def install(device: RigDevice) -> None:
    """Log the transfers of a rig's props from now on."""
    transfers, seen = Transfers(device.world), device.events.next_number

    def look() -> None:
        nonlocal seen
        if device.events.next_number > seen:
            if any(event["kind"] in ("placed", "task_placed") for event in device.events.since(seen)):
                transfers.reset()
        for event in transfers.update(device.clock.now()):
            device.events.add(event.pop("kind"), **event)
        seen = device.events.next_number

    device.each_advance.append(look)


def cycles(events: Sequence[dict[str, Any]]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Pairs of transfers, one right after the other, that bring a prop from A to B or back."""
    carries = [event for event in events if event["kind"] in ("transfer", "drop")]
    return [
        (first, last)
        for first, last in itertools.pairwise(carries)
        if first["kind"] == last["kind"] == "transfer" and {first["from"]["place"], last["to"]["place"]} == {"A", "B"}
    ]


class Transfers:
    """Follows the props of a world between its scene's places."""

    def __init__(self, world: World):
        self._world, self._contacts = world, Contacts(world)
        self.reset()

    def reset(self) -> None:
        """Forget what is under way: something was put somewhere."""
        self._lay: dict[str, np.ndarray] = {}  # where each prop last lay still
        self._still_since: dict[str, float] = {}
        self._way: dict[str, dict[str, Any]] = {}  # of the props that have left the table

    def update(self, now_s: float) -> list[dict[str, Any]]:
        """Return the events that end at a time of the clock.

        Each has `kind` ("transfer" or "drop"), `prop`, `start` and `end` (s), `lift_m`, `carry_m`, and `from` and `to`
        as {"place", "xy_m"}.
        """
        events = []
        for prop in (thing.name for thing in self._world.scene.props):
            joint, way, lay = self._world.data.joint(prop), self._way.get(prop), self._lay.get(prop)
            position = joint.qpos[:3].copy()
            moves = np.linalg.norm(joint.qvel[:3]) >= REST_SPEED_M_S
            if moves or (way is not None and self._contacts.look()[1][prop]):
                self._still_since.pop(prop, None)
            still = not moves and now_s - self._still_since.setdefault(prop, now_s) >= _REST_S
            if way is None and lay is not None and position[2] > lay[2] + _AIRBORNE_M:
                self._way[prop] = {"start": now_s, "from": position, "top_m": position[2]}
            elif way is None and still:
                self._lay[prop] = position
            elif way is not None and lay is not None:
                way["top_m"] = max(way["top_m"], position[2])
                if still and position[2] < lay[2] + _AIRBORNE_M:
                    events.append(self._event(prop, now_s, position))
        return events

    def _event(self, prop: str, now_s: float, end: np.ndarray) -> dict[str, Any]:
        way, lay = self._way.pop(prop), self._lay[prop]
        self._lay[prop] = end
        lift_m, carry_m = float(way["top_m"] - lay[2]), float(np.linalg.norm(end[:2] - way["from"][:2]))
        return {
            "kind": "transfer" if lift_m >= LIFT_M and carry_m >= CARRY_M else "drop",
            "prop": prop,
            "lift_m": lift_m,
            "carry_m": carry_m,
            "from": self._where(way["from"]),
            "to": self._where(end),
            "start": way["start"],
            "end": now_s,
        }

    def _where(self, position_m: np.ndarray) -> dict[str, Any]:
        places = (self._world.scene.places or {}).items()
        near = (name for name, at in places if np.linalg.norm(position_m[:2] - at[:2]) < _PLACE_RADIUS_M)
        return {"place": next(near, None), "xy_m": position_m[:2].tolist()}
