"""Transfers and cycles of one prop, told from the true world alone. Pure: `judge` feeds it.

In a transfer the prop leaves the table, rises by at least `LIFT_M`, and comes to rest at least `CARRY_M` away, in no
gripper. A cycle is a chain of transfers that brings it from one end place to the other.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lerobot_robot_yam.rig.judging.task_judge import FALL_M, REST_SPEED_M_S

LIFT_M = 0.05
CARRY_M = 0.15
AIRBORNE_M = 0.01
REST_S = 0.2
PLACE_RADIUS_M = 0.06
_STEP_S = 0.004  # a shorter one does not tell a speed

Point = tuple[float, ...]


class Transfers:
    """Follows one prop.

    Args:
        prop: its name, as in the events.
        places: name → (x, y) in m; names the ends of a transfer.
        ends: the two places between which a cycle runs.
    """

    def __init__(self, prop: str, places: Mapping[str, Sequence[float]], ends: Sequence[str] = ("A", "B")):
        self._prop = prop
        self._places = {name: (float(xy[0]), float(xy[1])) for name, xy in places.items()}
        self._ends = tuple(ends)
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
        if speed < REST_SPEED_M_S and not (self._moving is not None and held()):
            self._still_since = time_s if self._still_since is None else self._still_since
        else:
            self._still_since = None
        still = self._still_since is not None and time_s - self._still_since >= REST_S
        if self._moving is None:
            if self._rest is not None and position[2] - self._rest[2] > AIRBORNE_M:
                # Carrying counts from where it left the table: pushing it along the table does not.
                self._moving = {"start": now, "from": (*position[:2], self._rest[2]), "lift_m": 0.0}
            elif still:
                self._rest = position
            return []
        self._moving["lift_m"] = max(self._moving["lift_m"], position[2] - self._moving["from"][2])
        if not still or position[2] - self._moving["from"][2] > AIRBORNE_M:
            return []
        moving, self._moving, self._rest = self._moving, None, position
        return self._settled(moving, position, now)

    def _settled(self, moving: dict[str, Any], position: Point, now: dict[str, float]) -> list[dict[str, Any]]:
        good = moving["lift_m"] >= LIFT_M and math.dist(position[:2], moving["from"][:2]) >= CARRY_M
        events = [self._event("transfer" if good else "drop", moving, position, now)]
        if not good:
            self._cycle = None
            return events
        if self._place_of(moving["from"]) in self._ends:
            self._cycle = dict(moving)
        if self._cycle is not None:
            self._cycle["lift_m"] = min(self._cycle["lift_m"], moving["lift_m"])
            if {self._place_of(self._cycle["from"]), self._place_of(position)} == set(self._ends):
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
        """Name of the place the prop lies at, None when at none."""
        return next((name for name, xy in self._places.items() if math.dist(position_m[:2], xy) < PLACE_RADIUS_M), None)
