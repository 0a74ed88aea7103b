"""Monitor of the rail: its switches, the confirmation of its brake, and whether its motor follows."""

import math

from lerobot_robot_yam.control.mobile.rail_brake import CONFIRM_S, RailBrake
from lerobot_robot_yam.mobile.rail_profile import SOFT_END_M
from lerobot_robot_yam.state.faults import RAIL_SILENT_S, Trouble
from lerobot_robot_yam.system.boards.switch_board import BoardSample

_UNHEARD = 10  # ticks without a new sample after which they are silent; time alone is no proof, see channel_monitor
_ODD_S = 0.02  # time that readings must be impossible, s; a disturbance is shorter
_AT_END_M = 0.03  # distance from its end at which a switch may be triggered, m
_LAG_RAD = 0.5  # lag of the motor behind its plan that means that it is blocked, rad

Finding = tuple[Trouble, str]


class RailMonitor:
    """Monitor of one rail; check once per tick. silent: whether switches and brake are not heard."""

    def __init__(self, name: str, stroke_m: float):
        self._name, self._stroke_m = f"{name}: rail", stroke_m
        self._stamp_s, self._unheard, self._odd_s = -math.inf, 0, math.inf
        self.silent = False

    def check(
        self, now: float, sample: BoardSample, brake: RailBrake, height_m: float, lag_rad: float
    ) -> Finding | None:
        """Return what is wrong. height_m: NaN before homing. lag_rad: plan minus angle of the motor."""
        self._unheard = self._unheard + 1 if sample.stamp_s == self._stamp_s else 0
        self._stamp_s = sample.stamp_s
        self.silent = self._unheard >= _UNHEARD and now - sample.stamp_s > RAIL_SILENT_S
        if self.silent:
            what = f"switches and brake not heard for {min(now - sample.stamp_s, 99.0):.2f} s"
            return Trouble.RAIL_SILENT, f"{self._name}: {what}; check their cable, converter and power"
        odd = self._odd(sample, height_m)
        self._odd_s = math.inf if odd is None else min(self._odd_s, now)
        if odd is not None and now - self._odd_s >= _ODD_S:
            return odd
        if brake.unconfirmed(now):
            what = "engaged" if brake.engaged else "released"
            return Trouble.RAIL_BRAKE, f"{self._name}: no confirmation for {CONFIRM_S} s that the brake is {what}"
        if abs(lag_rad) > _LAG_RAD:
            return Trouble.RAIL_BLOCKED, (
                f"{self._name}: motor 9 is {lag_rad:+.2f} rad from where it should be: something is in the way, a "
                "switch has let the carriage run to the stop, or the brake has not released"
            )
        return None

    def _odd(self, sample: BoardSample, height_m: float) -> Finding | None:
        if sample.upper and sample.lower:
            return Trouble.RAIL_CABLE, (
                f"{self._name}: both switches read as triggered; their cable is off, or one is stuck (an open wire "
                "reads as triggered)"
            )
        for name, reads, beyond_m in (
            ("upper", sample.upper, height_m - self._stroke_m),
            ("lower", sample.lower, -height_m),
        ):
            where = f"{self._name}: at {height_m:.3f} m the {name} switch reads as"
            if reads and beyond_m < -_AT_END_M:
                return (
                    Trouble.RAIL_SWITCH,
                    f"{where} triggered: it is stuck, or its wire is off; home again then",
                )
            if not reads and beyond_m > SOFT_END_M:
                return Trouble.RAIL_SWITCH, f"{where} not triggered: it is broken, or the belt has slipped; home again"
        return None
