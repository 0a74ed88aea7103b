"""Was the task done? Stages of success, judged from the true world alone. Pure: `judge` feeds it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_robot_yam.rig.scene.tasks import Region, Stage, Task

REST_SPEED_M_S = 0.01
FALL_M = -0.05  # lower than this a prop lies beside the table


@dataclass(frozen=True)
class View:
    """The world at one instant.

    Attributes:
        sim_s: simulated time.
        frames: thing → origin (3,) and rotation (3, 3) of its frame, in the world.
        speeds: prop → m/s of its centre of mass.
        joints: jointed thing → position, m or rad.
        touching: prop → what touches it: channels of arms, names of things.
        held: prop → channels of arms whose two fingers both touch it.
    """

    sim_s: float
    frames: Mapping[str, tuple[np.ndarray, np.ndarray]]
    speeds: Mapping[str, float]
    joints: Mapping[str, float]
    touching: Mapping[str, frozenset[str]]
    held: Mapping[str, frozenset[str]]


class TaskJudge:
    """Follows one attempt at a task.

    arms: channels. begin: the world at the start. time_limit_s: in place of the task's, if not None.

    Attributes:
        stage: number of stages reached so far.
        success, failed: the verdict; once one of them is true it stands.
        reason: of the failure.
    """

    def __init__(self, task: Task, arms: frozenset[str], begin: View, time_limit_s: float | None = None):
        self._task, self._arms = task, arms
        self._time_limit_s = task.time_limit_s if time_limit_s is None else time_limit_s
        self._begin_s = begin.sim_s
        self._heights = {name: float(begin.frames[name][0][2]) for name in begin.speeds}
        self._met_since_s: float | None = None
        self.stage = 0
        self.success = self.failed = False
        self.reason = ""

    @property
    def decided(self) -> bool:
        """Whether the verdict is given."""
        return self.success or self.failed

    def update(self, view: View) -> list[dict[str, Any]]:
        """Look at the world; returns what this decides, as events.

        Their `kind` is "task_stage" (with `stage`, the number reached, 0 after a setback), "task_success" or
        "task_failed" (with `reason`). All have `task`, and in `since_s` the simulated time since the start.
        """
        if self.decided:
            return []
        since_s = view.sim_s - self._begin_s
        if fallen := [name for name in self._heights if view.frames[name][0][2] < FALL_M]:
            return [self._fail(f"the {fallen[0]} fell off the table", since_s)]
        if since_s > self._time_limit_s:
            text = f"the time limit of {self._time_limit_s:g} s has passed"
            return [self._fail(f"{text}; {self.stage} of {len(self._task.success)} stages were reached", since_s)]
        stage = self._task.success[self.stage]
        if stage.airborne and view.touching[stage.prop] - self._arms:
            before, self.stage, self._met_since_s = self.stage, 0, None
            return [self._event("task_stage", since_s, stage=0)] if before else []
        if not self._is_met(stage, view):
            self._met_since_s = None
            return []
        self._met_since_s = view.sim_s if self._met_since_s is None else self._met_since_s
        if view.sim_s - self._met_since_s < stage.for_s:
            return []
        self.stage, self._met_since_s = self.stage + 1, None
        self.success = self.stage == len(self._task.success)
        events = [self._event("task_stage", since_s, stage=self.stage)]
        return events + ([self._event("task_success", since_s)] if self.success else [])

    def _fail(self, reason: str, since_s: float) -> dict[str, Any]:
        self.failed, self.reason = True, reason
        return self._event("task_failed", since_s, reason=reason)

    def _event(self, kind: str, since_s: float, **details: Any) -> dict[str, Any]:
        return {"kind": kind, "task": self._task.name, "since_s": round(since_s, 4), **details}

    def _is_met(self, stage: Stage, view: View) -> bool:
        if stage.joint_range is not None:
            low, high = stage.joint_range
            if not low <= view.joints[stage.joint] <= high:
                return False
        prop = stage.prop
        if not prop:
            return True
        origin = view.frames[prop][0]
        return not (
            (stage.lifted_m is not None and origin[2] - self._heights[prop] < stage.lifted_m)
            or (stage.inside is not None and not _contains(stage.inside, origin, view))
            or (stage.held_by and stage.held_by not in view.held[prop])
            or (stage.released and view.touching[prop] & self._arms)
            or (stage.still and view.speeds[prop] > REST_SPEED_M_S)
        )


def _contains(region: Region, point: np.ndarray, view: View) -> bool:
    if region.frame:
        origin, rotation = view.frames[region.frame]
        point = rotation.T @ (point - origin)
    off = point - region.center_m
    return bool(np.hypot(*off[:2]) <= region.radius_m and abs(off[2]) <= region.height_m)
