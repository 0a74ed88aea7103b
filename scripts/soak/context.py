"""History according to the rig and the soak: motors with torque, injected faults, and pushes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.faults import FAULT_TROUBLE, Trouble
from soak.injected_faults import RANDOM

WATCHDOG_S = 0.4  # a motor without a command for this long switches itself off
_WATCHDOG_SLACK_S = 0.03  # difference between the rig's simulated time and the clock
_DEATHS = frozenset({"kill_control", "stop_control"})
# After a destroyed reply, the following replies count for older requests until a loss is told from a delay. If frames
# are held back as well, these replies are older than the limit for a silence.
_SILENCING = frozenset({"held_back", "garbled"})
_SILENCES = (Trouble.BUS_SILENT, Trouble.MOTOR_SILENT)
_AFTER_S = 3.0  # time after its end during which an injection may still cause trouble
_COOLS_S = 120.0  # cooling time of a motor heated without torque; until then it is hot for the next connection too
_HEAT = frozenset({Trouble.HOT, Trouble.MOS_TOO_HOT, Trouble.ROTOR_TOO_HOT})


@dataclass
class Cause:
    """An injected fault with start and end time; the end is infinite while the fault lasts."""

    number: int
    kind: str
    channel: str
    motor: str
    value: Any
    start_s: float
    end_s: float = math.inf


@dataclass
class ArmContext:
    """State of one arm according to the rig."""

    causes: list[Cause] = field(default_factory=list)
    enabled: set[str] = field(default_factory=set)
    changed_s: float = -math.inf  # time at which a motor last gained or lost torque
    faulty: dict[str, float] = field(default_factory=dict)  # motor → time of its fault


class Context:
    """History built from the rig's event log, in order.

    Args:
        channels: all arms.
        robots: groups of channels that are driven by one control process.
    """

    def __init__(self, channels: Sequence[str], robots: Sequence[Sequence[str]]):
        self.arms = {channel: ArmContext() for channel in channels}
        self._robots = [tuple(robot) for robot in robots]
        self.position = -1  # number of the latest injection
        self._stalls: list[tuple[float, float]] = []

    def stalled(self, start_s: float, end_s: float) -> None:
        """Record a stall of the machine or of a processor, in which processes did not run."""
        self._stalls.append((start_s, end_s))

    @property
    def stalls(self) -> int:
        """Number of stalls of the machine."""
        return len(self._stalls)

    def stood_still(self, since_s: float, until_s: float, at_least_s: float = 0.05) -> bool:
        """Return whether the machine stalled for at least `at_least_s` at some time in this span."""
        return any(a < until_s and b > since_s and b - a >= at_least_s for a, b in self._stalls)

    def take(self, event: Mapping[str, Any]) -> list[tuple[float, str, str]]:
        """Process one event of the rig.

        Returns:
            (monotonic s, channel, motor) of a motor that has lost communication without a reason, or an empty list.
        """
        kind, at_s = event["kind"], float(event["monotonic_s"])
        if kind == "injected":
            self._injected(event, at_s)
        elif kind == "undone":
            for arm in self.arms.values():
                for cause in arm.causes:
                    if cause.number == event["injection"]:
                        cause.end_s = at_s
        elif kind == "slipped":  # the rig itself was not running, so its motors were silent
            self.stalled(at_s - float(event["seconds"]), at_s)
        elif kind in ("motor_enabled", "motor_disabled", "motor_fault"):
            return self._motor(kind, event, at_s)
        return []

    def _injected(self, event: Mapping[str, Any], at_s: float) -> None:
        self.position = int(event["injection"])
        channel, kind = event["channel"], event["what"]
        concerned = [channel] if channel else []
        if kind in _DEATHS:
            concerned = [c for robot in self._robots if channel in robot for c in robot]
        for name in concerned:
            end_s = at_s + float(event["seconds"]) if kind == "push" else math.inf
            cause = Cause(self.position, kind, name, event["motor"], event["value"], at_s, end_s)
            self.arms[name].causes.append(cause)

    def _motor(self, kind: str, event: Mapping[str, Any], at_s: float) -> list[tuple[float, str, str]]:
        channel, motor = event["channel"], event["motor"]
        arm = self.arms[channel]
        arm.changed_s = at_s
        if kind == "motor_enabled":
            arm.enabled.add(motor)
            arm.faulty.pop(motor, None)
            return []
        arm.enabled.discard(motor)
        if kind == "motor_fault":
            arm.faulty[motor] = at_s
            if event["fault"] == Fault.COMMUNICATION_LOST and not self._cut_off(channel, motor, at_s):
                return [(at_s, channel, motor)]
        return []

    def _cut_off(self, channel: str, motor: str, at_s: float) -> bool:
        """Return whether injections kept commands from a motor for longer than its watchdog, or caused its fault."""
        for cause in self.arms[channel].causes:
            concerned = cause.motor in ("", motor) and cause.start_s <= at_s
            if concerned and cause.kind == "motor_fault" and at_s - cause.start_s < 0.5:
                return True
            # Sockets opened before an adapter was unplugged stay dead after its return.
            end_s = math.inf if cause.kind == "adapter_gone" else cause.end_s
            # A shorter cut is enough if the arm was switched off as the cut began: the motor missed the command.
            unheard = not self.arms[channel].enabled and at_s - cause.start_s < WATCHDOG_S + _WATCHDOG_SLACK_S
            least_s = 0.0 if unheard else WATCHDOG_S - _WATCHDOG_SLACK_S
            if concerned and RANDOM[cause.kind].cuts and min(at_s, end_s) - cause.start_s > least_s:
                return True
        return False

    def explained(self, channel: str, trouble: Trouble, at_s: float, for_s: float = 0.0) -> bool:
        """Return whether an injection into the arm can be the cause of trouble reported at `at_s`.

        The trouble may have existed for `for_s` before the report.

        A motor reports its fault while the fault lasts, anew in each mode.
        """
        arm = self.arms[channel]
        if trouble in FAULT_TROUBLE.values() and any(since_s <= at_s for since_s in arm.faulty.values()):
            return True
        if trouble in _HEAT and any(c.kind == "motor_hot" and at_s < c.end_s + _COOLS_S for c in arm.causes):
            return True
        acting = {cause.kind for cause in arm.causes if cause.start_s <= at_s <= cause.end_s + _AFTER_S + for_s}
        if trouble in _SILENCES and acting >= _SILENCING:
            return True
        return any(trouble in RANDOM[kind].troubles for kind in acting)

    def undisturbed(self, channel: str, since_s: float, until_s: float, kinds: frozenset[str]) -> bool:
        """Return whether all motors of the arm had torque in this span, and no fault of `kinds` was active."""
        arm = self.arms[channel]
        if not arm.enabled or arm.faulty or arm.changed_s > since_s:
            return False
        return not any(c.kind in kinds and c.start_s < until_s and c.end_s > since_s for c in arm.causes)

    def forget_before(self, at_s: float) -> None:
        """Forget causes that ended before `at_s`, because they can no longer explain anything."""
        for arm in self.arms.values():
            arm.causes = [c for c in arm.causes if c.end_s > at_s or (c.kind == "adapter_gone" and c.start_s > at_s)]
