"""Checks of the arms' true state in the rig: speed, torque, poses at torque cuts, and correctness of state records."""

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import recorders

from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.state.faults import STALE_OVERSHOOT_RAD_S, stale_overshoot_rad_s
from soak.arm import Arm
from soak.checks import GRIPPER, READY, TICK_S, Finding, mode_of
from soak.context import Context
from soak.injected_faults import LEADERS
from soak.seeds import judge_seed

_SETTLE_S = 1.0  # an arm may still move this long after a push, a collision, or a motor's loss or return, s
_COASTS_S = 3.0  # maximum time that a floating arm takes to come to rest after it was released in motion, s
_SPEED_FACTOR, _SPEED_SLACK = 1.2, 0.15
_GRIPPER_SPEED_FACTOR = 1.4  # the light gripper overshoots when a late tick makes its ramp jump
_PUNCTUAL_S = 0.004  # a punctual command acts for one tick plus this time on the wire
_KEPT_UP_S = 0.001  # command age, beyond one tick, above which a command was late or lost (1 % are lost)
_CARRIED_BY = np.array([1.0, 1.0, 2.0, 3.0, 3.0, 3.0])  # factor on each joint's overshoot: its carriers brake too
_CUT_OFF_S = 0.02  # age from which a gripper's speed is not judged: it leaps to its ramp, which has moved on
_FREE_SPEED = 1.1  # factor on the speed limit: a joint that came free must have been faster
_TORQUE_FACTOR, _TORQUE_SLACK_NM = 1.05, 1.0  # between ticks a motor reacts alone; a blow is faster
_NOTICED_S = 0.3  # time within which a motor without torque must be noticed
_LANDED_RAD = 0.1  # maximum distance of joints 2 to 4 from the rest pose in a landed pose
_CARRYING = slice(1, 4)  # joints 2 to 4 have parallel axes and carry weight
_LET_GO_S = 0.5  # a hand seen on an arm this recently before a torque cut may have let go at the cut
_BEFORE_S = 0.05  # span of true samples requested before a cut; one sample is sufficient
_FALL_M, _FALL_S = 0.01, 1.0  # maximum motion of a body within _FALL_S after a torque cut by the driver
_TRUTH_RAD, _TRUTH_RAD_PER_S = 0.02, 3.0  # maximum error of a state, plus this much per second of its age
_FRESH_S = 0.25
_KNOWN_S = 0.004  # maximum state age behind an acting command: two ticks, and this time on the wire
_KEPT_S = 2.0  # span of true samples that the rig keeps; longer than the interval between looks
_SLOW_ADAPTERS = frozenset({"slow_adapter", "held_back"})
_SLOW_S = 0.12  # additional state age that slow adapters may cause
_PUSHES = frozenset({"push"})
_LYING = frozenset({"reading_lies", "reading_drifts", "garbled", "second_arm"})
_REARMED_S = 2.0  # time within which the arm has been re-armed after the fault
_STALE_COMMANDS = frozenset(  # faults after which the motors keep executing the last command received
    {
        "cable_out_briefly",
        "cable_out",
        "link_down",
        "bus_off",
        "adapter_gone",
        "motor_silent",
        "kill_control",
        "stop_control",
    }
)


class Truth:
    """Checks the rig: call `look` several times a second, then `take` with each of its events, then `judge`.

    Args:
        rig: connection to the rig.
        arms: arms by channel.
        context: record of events; must have taken the events before `judge`.
    """

    def __init__(self, rig: RigControl, arms: Mapping[str, Arm], context: Context):
        self._rig, self._arms, self._context = rig, arms, context
        self._pose: dict[str, Any] = {}  # at the last look
        self._windows: list[tuple[str, dict[str, Any], float, bool]] = []
        self._differences: list[Finding] = []
        # channel → time of the torque cut, and the arm's joints and bodies at that time
        self._cuts: dict[str, tuple[float, np.ndarray, dict[str, Any]]] = {}
        self.unjudged_cuts = 0
        self._held_s: dict[str, float] = {}  # channel → time at which a hand was last seen on the leader
        self._touched_s: dict[str, float] = {}  # channel → time at which the arm last touched anything
        self._age_s: dict[str, np.ndarray] = {}  # channel → ages of the oldest commands obeyed in the previous window
        self._unnoticed: set[tuple[str, str, float]] = set()
        self.largest: dict[str, tuple[float, str]] = {}  # figure → largest value, and where it occurred
        for channel in arms:
            recorders.watch_start(rig, channel)
            recorders.truth_start(rig, channel, _KEPT_S)

    def look(self) -> None:
        """Read extremes since the last look, and the current pose."""
        windows = []
        for channel in self._arms:
            windows.append((channel, recorders.watch(self._rig, channel), time.monotonic()))
            recorders.watch_start(self._rig, channel)
        records = {channel: arm.read() if arm.record is None else arm.record for channel, arm in self._arms.items()}
        pose = self._rig.state(bodies=True)
        for channel, record in records.items():
            if pose["arms"][channel]["held"]:
                self._held_s[channel] = time.monotonic()
            if record is not None and self._arms[channel].driven:
                self._compare(channel, record, pose)
        for channel, seen, now in windows:  # after reading the pose: a hand may have gripped since the last look
            by_hand = now - self._held_s.get(channel, -math.inf) < _COASTS_S
            self._touched_s[channel] = max(self._touched_s.get(channel, -math.inf), seen["touched_at_s"])
            touched = seen["since_s"] - self._touched_s[channel] < _SETTLE_S
            self._windows.append((channel, seen, now, by_hand or touched))
        self._pose = pose

    def _compare(self, channel: str, record: Any, pose: Mapping[str, Any]) -> None:
        """Compare a state record with the true state."""
        true, speed = np.array(pose["arms"][channel]["q"]), np.abs(pose["arms"][channel]["dq"])
        age = np.abs(pose["monotonic_s"] - record["motor_stamp_s"][: len(true)])
        difference = np.abs(true - record["q"][: len(true)])
        fresh = age < _FRESH_S
        beyond = np.where(fresh, difference - age * (_TRUTH_RAD_PER_S + 2.0 * speed), 0.0)
        beyond = np.nan_to_num(beyond)
        self._note("state against the truth, rad", float(beyond.max()), f"{channel} joint_{int(beyond.argmax()) + 1}")
        if beyond.max() > _TRUTH_RAD:
            joint = int(beyond.argmax())
            what = f"joint_{joint + 1} says {record['q'][joint]:.3f}, is {true[joint]:.3f} rad"
            self._differences.append(Finding("the state is true", pose["monotonic_s"], channel, what))

    def take(self, event: Mapping[str, Any]) -> None:
        """Process one event of the rig."""
        if event["kind"] == "motor_disabled":
            channel, at_s = event["channel"], float(event["monotonic_s"])
            if channel in self._cuts:
                return
            samples = recorders.truth(self._rig, channel, at_s - _BEFORE_S)
            stamps_s = samples["stamp_s"]
            if len(stamps_s) and stamps_s[0] <= at_s:
                then = int(np.searchsorted(stamps_s, at_s, side="right")) - 1
                self._cuts[channel] = at_s, samples["q"][then], event["bodies"]
            else:  # the monitor did not look in time: the rig keeps samples for `_KEPT_S`
                self.unjudged_cuts += 1
        elif event["kind"] == "motor_enabled":
            self._cuts.pop(event["channel"], None)

    def judge(self) -> list[Finding]:
        """Return the violations since the last call."""
        found, self._differences = self._differences, []
        for channel, seen, until_s, by_others in self._windows:
            arm = self._arms[channel]
            n = len(arm.torque_limit)
            since_s = float(seen["since_s"])
            age_s = np.array(seen["max_command_age_s"])[:n]
            oldest_s = np.maximum(age_s, self._age_s.get(channel, age_s))
            oldest_s[GRIPPER:] = np.maximum(oldest_s, arm.reading_age_s(since_s - _SLOW_S, until_s)[:n])[GRIPPER:]
            late_s = np.maximum(oldest_s - arm.tick_s - _PUNCTUAL_S, 0.0)[:GRIPPER]
            self._age_s[channel] = age_s
            if not by_others and self._context.undisturbed(channel, since_s - _SETTLE_S, until_s, _PUSHES):
                slow = self._happened(_SLOW_ADAPTERS, channel, since_s - _SLOW_S, until_s)
                allowed = allowed_speed_rad_s(arm.motor_speed_limit[:n], oldest_s, slow, arm.tick_s)
                ratio = np.array(seen["max_speed_rad_s"])[:n] / allowed
                i = int(ratio.argmax())
                self._note("joint speed, of 1.2 x its limit", float(ratio.max()), f"{channel} {seen['motors'][i]}")
                if ratio.max() > 1.0:
                    what = f"{seen['motors'][i]} at {seen['max_speed_rad_s'][i]:.2f} rad/s, allowed {allowed[i]:.2f}"
                    found.append(Finding("joint speed", seen["max_speed_at_s"][i], channel, what))
            pushed = self._happened(_PUSHES, channel, since_s - _SETTLE_S, until_s)
            struck = not self._context.undisturbed(channel, since_s - _SETTLE_S, until_s, _PUSHES)  # by a limp joint
            # If a leader joint's readings are rejected, the joint is held at its set-point, however far a hand pushes.
            blind = channel in LEADERS and self._happened(_LYING, channel, since_s - _REARMED_S, until_s)
            stale = self._happened(_STALE_COMMANDS, channel, since_s - 0.1, until_s)
            if not (pushed or struck or blind or stale):
                allowed = _TORQUE_FACTOR * arm.torque_limit + _TORQUE_SLACK_NM
                allowed[:GRIPPER] += arm.kp[:GRIPPER] * arm.motor_speed_limit[:GRIPPER] * late_s
                ratio = self._asked(channel, seen, allowed, late_s) / allowed
                i = int(ratio.argmax())
                self._note("motor torque, of its clip", float(ratio.max()), f"{channel} {seen['motors'][i]}")
                if ratio.max() > 1.0:
                    asked = f"{ratio[i] * allowed[i]:.2f} Nm, clip {arm.torque_limit[i]:.1f}"
                    what = f"{seen['motors'][i]} is asked for {asked}"
                    found.append(Finding("torque clip", seen["max_asked_at_s"][i], channel, what))
        self._windows.clear()
        return found + self._judge_cuts() + self._judge_notice()

    def _asked(self, channel: str, seen: Mapping[str, Any], allowed: np.ndarray, late_s: np.ndarray) -> np.ndarray:
        """Return the largest commanded torques (n,), without excesses that the joints' own motion explains."""
        arm, n = self._arms[channel], len(allowed)
        asked = np.array(seen["max_asked_nm"])[:n]
        if (asked <= allowed).all():
            return asked
        known_s = np.full(n, 2.0 * arm.tick_s + _KNOWN_S)
        known_s[:GRIPPER] += late_s
        since_s = float(seen["since_s"])
        if self._happened(_SLOW_ADAPTERS, channel, since_s - _SLOW_S, math.inf):
            known_s += _SLOW_S
        truth = recorders.truth(self._rig, channel, since_s - float(known_s.max()))
        beyond: np.ndarray = recorders.beyond_clip_nm(truth, arm.kp[:n], arm.kd[:n], allowed, known_s)
        return np.where(asked > allowed, allowed + np.where(beyond > 0.0, beyond, 0.0), asked)

    def judge_seeds(self) -> list[Finding]:
        """Check set-points that jumped onto the arm according to the records: was the arm there?"""
        found = []
        for channel, arm in self._arms.items():
            for seed in arm.check.take_seeds():
                what = judge_seed(
                    seed, recorders.truth(self._rig, channel, seed.since_s), _FREE_SPEED * arm.speed_limit
                )
                if what:
                    found.append(Finding("no set-point jump", seed.at_s, channel, what))
        return found

    def _happened(self, kinds: frozenset[str], channel: str, since_s: float, until_s: float) -> bool:
        causes = self._context.arms[channel].causes
        return any(c.kind in kinds and c.start_s < until_s and c.end_s > since_s for c in causes)

    def _judge_cuts(self) -> list[Finding]:
        """Check commanded torque cuts: each must be in the landed pose, or no body may move afterwards."""
        found = []
        pose = self._pose
        for channel, (at_s, q, bodies) in list(self._cuts.items()):
            if pose["monotonic_s"] <= at_s:
                continue
            pushed = self._happened(
                _PUSHES, channel, at_s - 2.0 * self._arms[channel].tick_s - _KNOWN_S, pose["monotonic_s"]
            )
            if pushed or self._held_s.get(channel, -math.inf) >= at_s - _LET_GO_S:
                del self._cuts[channel]  # a hand moves a limp arm freely, and may drop it
                continue
            moved, body = _farthest(bodies, pose["bodies"])
            off = np.abs(q[: len(self._arms[channel].rest_q)] - self._arms[channel].rest_q)[_CARRYING]
            if (off > _LANDED_RAD).any():
                self._note("way of a body after a cut elsewhere than landed, m", moved, f"{channel} {body}")
                if moved > _FALL_M:
                    where = f"at joints 2 to 4 of {np.round(q[_CARRYING], 2).tolist()} rad"
                    what = f"{body} moved {moved * 100:.1f} cm after torque was cut {where}"
                    found.append(Finding("no torque cut above a landed pose", at_s, channel, what))
                    del self._cuts[channel]
                    continue
            if pose["monotonic_s"] - at_s > _FALL_S:
                del self._cuts[channel]
        return found

    def _judge_notice(self) -> list[Finding]:
        """Check that motors without torque are noticed."""
        found = []
        now = time.monotonic()
        for channel, arm in self._arms.items():
            if not arm.driven or mode_of(arm.record) not in READY or now - float(arm.record["stamp_s"]) > _FRESH_S:
                continue
            for motor, since_s in self._context.arms[channel].faulty.items():
                late = float(arm.record["stamp_s"]) - since_s > _NOTICED_S
                if late and (channel, motor, since_s) not in self._unnoticed:
                    self._unnoticed.add((channel, motor, since_s))
                    mode = mode_of(arm.record).name
                    found.append(
                        Finding("a lost motor is noticed", since_s, channel, f"{motor} without torque in {mode}")
                    )
        return found

    def _note(self, what: str, value: float, where: str) -> None:
        self.largest[what] = max(self.largest.get(what, (0.0, "")), (value, where))


def allowed_speed_rad_s(
    limit_rad_s: np.ndarray, oldest_s: np.ndarray, slow: bool, tick_s: float = TICK_S
) -> np.ndarray:
    """Return the maximum allowed motor speeds (n,).

    A joint whose command is late moves on while the joints that carry it brake, and is thrown ahead. The same happens
    to a joint whose own command arrived while theirs did not, so joints 2 to 4 count as late as the latest of them. A
    gripper whose commands or readings are late is held back, and then leaps to its ramp.

    Args:
        limit_rad_s: (n,) speed limits of the set-points.
        oldest_s: (n,) maximum time for which a command was obeyed; for a gripper, the age of the oldest reading if
            this is larger.
        slow: whether the adapter delayed the motors' replies.
        tick_s: period of the control loop, s.
    """
    allowed = _SPEED_FACTOR * limit_rad_s + _SPEED_SLACK
    late_s = np.maximum(oldest_s[:GRIPPER] - tick_s - _KEPT_UP_S, 0.0)
    late_s[_CARRYING] = late_s[_CARRYING].max()
    allowed[:GRIPPER] += [
        min(count * stale_overshoot_rad_s(float(late)), STALE_OVERSHOOT_RAD_S)
        for count, late in zip(_CARRIED_BY[: len(late_s)], late_s, strict=True)
    ]
    allowed[GRIPPER:] = _GRIPPER_SPEED_FACTOR * limit_rad_s[GRIPPER:] + _SPEED_SLACK
    allowed[GRIPPER:][slow | (oldest_s[GRIPPER:] > _CUT_OFF_S)] = math.inf
    return allowed


def _farthest(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[float, str]:
    """Return the distance, m, and name of the body of an arm that moved farthest.

    before: positions of this arm's bodies, by name. after: positions of all bodies.
    """
    moved = {name: float(np.linalg.norm(np.subtract(after[name], place))) for name, place in before.items()}
    body = max(moved, key=lambda name: moved[name])
    return moved[body], body.partition("/")[2]
