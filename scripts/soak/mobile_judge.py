"""Judge of the soak of a mobile robot: compares what is true in the world with what the states say."""

import logging
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lerobot_robot_yam.mobile.base_profile import FLIP_RAD_S, HARD_CAP_ACCELERATION
from lerobot_robot_yam.state.faults import RESPONSES, Response, Trouble
from lerobot_robot_yam.state.modes import Mode
from soak.mobile_faults import BASE, MobileFaults

logger = logging.getLogger("soak")

STEP_S = 0.05  # period of the caller and of the judge, s
REST_M_S, _REST_RAD_S = 0.02, 0.05  # speed below which a base stands
_REST_S = 4.5  # by then a base that brakes from any speed is at rest, s
_SINKS_M, _HOLDS_S = 0.02, 1.0  # maximum sinking of the tool of an arm that holds, m, once it has come to rest
_BRAKES_M = 0.06  # maximum sinking of the tool until then, m: braking takes 40 mrad at 0.6 m, the delay at most as much
_FALLS_M, _SETTLES_S = 0.005, 1.5  # maximum fall of the rail, m, once it has had time to brake, s
_LONGEST_TICK_S = 0.012  # the loop plans no longer step than this, s


class MobileJudge:
    """Judge of one run.

    Args:
        faults: what was injected.
        violate: callback that receives invariant, part and description.
    """

    def __init__(self, faults: MobileFaults, violate: Callable[[str, str, str], None]):
        self._faults, self._violate = faults, violate
        self.forget()

    def forget(self) -> None:
        """Start anew, after the robot was connected."""
        self._since: dict[str, tuple[Mode, float, float]] = {}  # mode, since when, height of tool or carriage then
        self._rests_m: dict[str, float] = {}  # height of the tool of an arm that has come to rest
        self._planned: tuple[int, np.ndarray] | None = None
        self._pose: np.ndarray | None = None
        self._settled_m = 0.0  # height of the carriage since it has to stay

    def look(self, now: float, world: dict[str, Any], states: dict[str, Any]) -> None:
        """Judge one step. states: name -> state as published."""
        carriage_m = world[BASE]["rail"]["height"]
        for name, state in states.items():
            height = carriage_m if name == BASE else world["arms"][name]["tcp_site"]["pos"][2] - carriage_m
            if name not in self._since or self._since[name][0] is not state.mode:
                self._since[name] = state.mode, now, height
                self._rests_m.pop(name, None)
            since_s, begin = self._since[name][1:]
            self._judge_trouble(name, state, now, now - since_s)
            if name == BASE:
                self._judge_plan(state)
                self._judge_rest(state, now, now - since_s, np.array(world[BASE]["pose"]))
                self._judge_rail(state, now - since_s, height)
            elif state.trouble is None and state.mode in (Mode.HOLD, Mode.STOPPED) and now - since_s > _HOLDS_S:
                if self._faults.cut(name, now):
                    self._rests_m[name] = height
                rests = name in self._rests_m
                sunk_m = (self._rests_m[name] if rests else begin) - height
                self._rests_m.setdefault(name, height)
                if sunk_m > (_SINKS_M if rests else _BRAKES_M):
                    self._violate("holds", name, f"the tool has sunk by {sunk_m * 1e3:.0f} mm")

    def _judge_trouble(self, name: str, state: Any, now: float, for_s: float) -> None:
        if state.trouble is Trouble.INTERNAL_ERROR:
            self._violate("no internal error", name, state.message)
        elif state.trouble is not None and for_s < STEP_S and not self._faults.explain(name, state.trouble, now):
            self._violate("trouble has a cause", name, f"{state.trouble}: {state.message}")

    def _judge_plan(self, state: Any) -> None:
        if self._planned is not None:
            ticks, before = state.tick - self._planned[0], self._planned[1]
            seconds = min(_LONGEST_TICK_S * max(ticks, 1), STEP_S + 0.03)
            if (np.abs(state.planned - before) > np.array(HARD_CAP_ACCELERATION) * seconds + 1e-6).any():
                self._violate("acceleration", BASE, f"planned {before} then {state.planned}")
        self._planned = state.tick, state.planned

    def _judge_rest(self, state: Any, now: float, for_s: float, pose: np.ndarray) -> None:
        before, self._pose = self._pose, pose
        if not self._faults.lie(BASE, now) and state.trouble is None:
            if np.abs(state.steer_rad_s).max() > 1.3 * FLIP_RAD_S:
                self._violate("no flip", BASE, f"steering at {state.steer_rad_s}")
        lost = state.trouble is not None and RESPONSES[state.trouble].arm is Response.LOST
        if state.mode not in (Mode.FAULT, Mode.STOPPED, Mode.HOLD) or for_s < _REST_S or lost or before is None:
            return
        moved = (pose - before) / STEP_S
        if np.hypot(*moved[:2]) > REST_M_S or abs(math.remainder(moved[2], math.tau)) > _REST_RAD_S:
            if not self._faults.cut(BASE, now):
                self._violate("stands", BASE, f"moves by {moved} in mode {state.mode.name}")

    def _judge_rail(self, state: Any, for_s: float, height_m: float) -> None:
        """Check that the carriage does not fall where it has to stay."""
        if state.mode not in (Mode.FAULT, Mode.STOPPED, Mode.OFF) or for_s < _SETTLES_S:
            self._settled_m = height_m
        elif self._settled_m - height_m > _FALLS_M:
            self._violate("the load does not fall", BASE, f"by {(self._settled_m - height_m) * 1e3:.1f} mm")
            self._settled_m = height_m
