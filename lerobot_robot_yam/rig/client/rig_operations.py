"""The operations of a rig, a method each, whether it runs in another process or in lock-step.

Times are simulated seconds unless a key says `monotonic_s`; lengths in m, angles in rad, forces in N.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.rig.client.hand_operations import HandOperations


class RigOperations(HandOperations):
    """The operations. Each raises ConfigError when the rig refuses: an unknown name, or a value that does not fit."""

    name: str

    # reading

    def scene(self) -> dict[str, Any]:
        """Arms with their placement, places, homes, seed, props, furniture and tasks; fields as in scene files.

        And the names of its cameras.
        """
        return self.request("scene")

    def forces(self, channel: str) -> dict[str, Any]:
        """What acts on an arm from outside, but for pushes. Forces are (3,) N in world axes.

        Returns:
            tool_n: the sum of all contacts of the tool with other things than the arm; hand_n: of a soft hand;
            contacts: body, other, point_m, force_n of each contact of the arm with other things.
        """
        return self.request("forces", channel=channel)

    def task_state(self) -> dict[str, Any]:
        """How the attempt at the task stands.

        Returns:
            task (None before the first), seed, success, failed, reason (of the failure), since_s (simulated time from
            the placing to the verdict, or to now), stage (stages reached) of stages.
        """
        return self.request("task_state")

    def stats(self) -> dict[str, Any]:
        """Server's pid, cpu_s, uptime_s, sim_s, slips, wakes, realtime, frames and overflows per channel."""
        return self.request("stats")

    def events(self, since: int = 0) -> list[dict[str, Any]]:
        """All events from number `since` on, each with number, sim_s, monotonic_s, kind and details.

        motor_disabled has channel, motor, and the positions of the arm's bodies at that moment, as in `state`.
        """
        found: list[dict[str, Any]] = []
        while chunk := self.request("events", since=since)["events"]:
            found += chunk
            since = chunk[-1]["number"] + 1
        return found

    def trace_start(self, channel: str) -> None:
        """From now on record every frame that clients send to the channel."""
        self.request("trace", channel=channel, start=True)

    def trace(self, channel: str) -> list[tuple[float, float, int, int]]:
        """(sent, arrived at the rig, identifier, first data byte) of every frame since `trace_start`; monotonic s."""
        found: list[tuple[float, float, int, int]] = []
        while chunk := self.request("trace", channel=channel, since=len(found))["frames"]:
            found += [(sent, arrived, ident, first) for sent, arrived, ident, first in chunk]
        return found

    def watch_start(self, channel: str) -> None:
        """From now on record the arm's extremes, anew; for `watch`."""
        self.request("watch", channel=channel, start=True)

    def watch_stop(self, channel: str) -> None:
        """Stop recording; `watch` still returns the record."""
        self.request("watch", channel=channel, stop=True)

    def watch(self, channel: str) -> dict[str, Any]:
        """The extremes since `watch_start`, looked at every 2 to 4 ms of simulated time, torques every millisecond.

        Returns:
            since_s (monotonic). motors: n names, gripper last.
            max_speed_rad_s (n), of motors while enabled, and max_torque_nm (n), magnitudes at the joint (gripper: at
            the motor). max_asked_nm (n): the torque that the command asked for before the motor's own limit. Each with
            the monotonic time of the largest: max_speed_at_s, max_torque_at_s, max_asked_at_s (0 before the first).
            max_command_age_s (n): the longest that an enabled motor acted on one command, simulated time.
            min_tcp_z_m; max_tcp_drop_m, below its height at the start.
            touched_at_s: when it last touched anything, or pressed on itself with more than 50 N (0: never).
            enabled_events: (monotonic_s, motor, enabled) of every change. fault_events: (monotonic_s, motor, code).
        """
        found = chunk = self.request("watch", channel=channel)
        seen = chunk["changes"]
        while chunk["changes"]:
            chunk = self.request("watch", channel=channel, since=seen)
            seen += chunk["changes"]
            for key in ("enabled_events", "fault_events"):
                found[key] += chunk[key]
        for key in ("enabled_events", "fault_events"):
            found[key] = [tuple(row) for row in found[key]]
        del found["changes"]
        return found

    def truth_start(self, channel: str, seconds: float = 1.0) -> None:
        """From now on keep the last seconds (at most 120) of the channel's true shaft states, for `truth`."""
        self.request("truth", channel=channel, start=True, seconds=seconds)

    def truth_stop(self, channel: str) -> None:
        """Keep them no longer."""
        self.request("truth", channel=channel, stop=True)

    def truth(self, channel: str, after_s: float = 0.0) -> dict[str, np.ndarray]:
        """True states of the shafts of the channel's n motors, one row per step of the physics (1 ms), oldest first.

        Args:
            after_s: only later rows, monotonic s.

        Returns:
            stamp_s (k,) monotonic; q (k, n), dq (k, n) at that time, joint sign, gripper at the motor; torque_nm (k, n)
            that the motors applied in the step before; asked_nm (k, n), which their commands asked for then,
            kp (q* − q) + kd (dq* − dq) + tau, not cut by the motors' own limits.
        """
        rows: list[Any] = []
        while chunk := self.request("truth", channel=channel, after_s=after_s)["samples"]:
            rows += chunk
            after_s = chunk[-1][0]
        columns = zip(*rows, strict=True) if rows else [()] * 5
        return dict(zip(("stamp_s", "q", "dq", "torque_nm", "asked_nm"), map(np.array, columns), strict=True))

    # changing

    def place(self, prop: str, pos: Sequence[float], quat: Sequence[float] = (1, 0, 0, 0)) -> None:
        """Put a prop somewhere, at rest."""
        self.request("place", prop=prop, pos=pos, quat=quat)

    def task(self, name: str, seed: int, time_limit_s: float | None = None) -> None:
        """Begin an attempt at a task of the scene: its things are strewn by the seed, at rest; the arms stay.

        `time_limit_s`: simulated time after which it has failed; None: that of the task.
        """
        self.request("task", name=name, seed=seed, time_limit_s=time_limit_s)

    def set_pose(self, channel: str, q: Sequence[float] | None = None, opening: float | None = None) -> None:
        """Teleport an arm (n,) and its gripper (0 closed … 1 open), at rest."""
        self.request("set_pose", channel=channel, q=q, opening=opening)

    def push(self, channel: str, body: str, force: Sequence[float], seconds: float) -> None:
        """Push a body of an arm with a force (3,) in world axes: "tool", at its frame, or "link4", at its centre."""
        self.request("push", channel=channel, body=body, force=force, seconds=seconds)

    def fault(self, channel: str, motor: str | int | None, kind: str, value: Any = True, **details: Any) -> None:
        """Make something fail, until `clear_faults` or the same kind with False, 0 or its usual value.

        Of one motor (name or CAN id) or, with None, of every motor of the channel:
            "silent" (bool): neither obeys nor answers.
            "power" (bool): False cuts its power; True gives it back, with the registers that its flash holds.
            "storing" ("reverts" or "cut", or False): what STORE does: other registers become what flash held; or the
                power goes in the middle.
            "drop_next" (answers), "loss_rate" (0 … 1), "delay_s" (s): answers are lost or late.
            "command_loss_rate" (0 … 1): share of frames that it does not hear.
            "duplicate" (bool, or {"q_rad": rad}): a second motor has its identifiers, see "second_arm".
            "wrong_id" (identifier, or False): answers come under it; the registers do not know it.
            "corrupt_rate" (0 … 1; all_bytes=True): share of answers with random contents; motor number and fault
                code stay right without all_bytes.
            "reading" ({"position_rad", "velocity_rad_s", "torque_nm", "answers", "freeze"}, each optional, or False):
                its answers lie, and its own servo does not know. They add these offsets (joint sign; positions wrap at
                the end of the frame's range), the next `answers` of them or all. With "freeze": true all repeat the
                first one's position, velocity and torque.
            "temperatures_c" ([power stage, coil] °C, or False): its sensors lie; the motor does not act on them.
            "temperature_ramp" ({"rate_c_per_s", "from_c", "part": "both", "mos" or "rotor"}, or False): it warms or
                cools from from_c on. At OT_VALUE (power stage, 0xB) or 100 °C (coil, 0xC) it switches itself off,
                and again after each CLEAR while it is as hot.
            "torque_bias_nm" (Nm, joint sign): while enabled it adds this torque, and does not report it.
            "stuck" (bool): jammed. "friction_nm" (Nm): additional dry friction.
            "nibble" (fault code; sticky=True survives CLEAR): it fails with that code now.
            "register" (value; register=number): overwrites a register, read-only ones too.
        Of the channel, motor None:
            "link_down" (bool): as `ip link set canX down`: send and receive raise "Network is down".
            "adapter_gone" (bool): open buses are dead for good ("No such device"), opening raises BusError.
            "bus_off" (bool): one error frame (0x40), nothing gets through, sends raise "No buffer space available"
                after 10 frames; ended by False, or by link_down.
            "cable_out" (bool): nothing gets through, and nobody is told.
            "foreign" ({"id", "rate_hz", "payload": "hold" or "zero"}, or False): another computer sends frames to
                that identifier: MIT commands to stay where the motor is, or eight zero bytes. Motors obey and answer.
            "latency_s" (s): each way; commands reach the motors late, and answers the host. Time stamps are those of
                the arrival at the host.
            "hold_back" ({"seconds", "every_s", "stamped"}, or False): from now on, again every every_s or once, the
                adapter keeps received frames back for so long and then gives them all at once, in order, stamped with
                that moment; with "stamped": true with the time at which the wire delivered them.
            "second_arm" (bool, or {"q_rad": rad per motor, joint sign}): another arm with the same identifiers is on
                the bus. Each of its motors hears every frame and answers after the first arm's, with its own registers,
                fault code and bare shaft. It is limp until it is enabled. Without q_rad the shafts are 0.3 rad from
                where the arm was when the rig started. `state` shows them as second_motors.
            "payload_kg" (kg): a point mass at the tool.
            "link_mass" ({"link": "link3", "factor"}): a factor on the link's mass in the profile.
            "handle_silent" (bool).
            "encoders_silent" (bool, or numbers of devices from 0): of a leader without motors.
        """
        self.request("fault", channel=channel, motor=motor, kind=kind, value=value, **details)

    def clear_faults(self, channel: str) -> None:
        """Undo all that `fault` did to the channel, except registers and latched fault codes."""
        self.request("clear_faults", channel=channel)

    def camera_fault(self, camera: str, kind: str | None, seconds: float | None = None) -> None:
        """Make a camera of the scene fail for every client.

        "stall": no new frames, for `seconds` or until None. "dead": its clients are told, and it cannot be opened. None
        ends both; clients of a dead camera connect anew.
        """
        self.request("camera_fault", camera=camera, kind=kind, seconds=seconds)

    def cut_torque(self, channel: str) -> None:
        """Disable every motor of the arm at once, as an emergency stop of its supply would."""
        self.request("cut_torque", channel=channel)

    def log(self, kind: str, **details: Any) -> None:
        """Add an event to the rig's log."""
        self.request("log", kind=kind, details=details)
