"""Extremes of the arms that the rig itself records, so that a soak can assert them without missing a tick.

Off by default. While it is on for any channel, torques are looked at in every step of the physics, and the rest after
every advance (at most 4 ms of simulated time), in one pass over all motors.
"""

import itertools
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.system.clock import Clock

_PERIOD_S = 0.002  # simulated time between two looks, at least
_CHANGES_KEPT = 50_000
_PRESS_N = 50.0  # of an arm on itself, at a point; the wrist of a folded limp arm presses with 27


class Change(NamedTuple):
    """A motor was enabled, disabled or entered a fault, at a time of the rig's clock."""

    at_s: float
    motor: str
    switched: bool  # `enabled` was different before
    enabled: bool
    fault: int  # its code, 0 without


class Largest:
    """The largest of each of n values so far, and when it was reached."""

    def __init__(self, count: int):
        self.value, self.at_s = np.zeros(count), np.zeros(count)

    def forget(self, rows: slice) -> None:
        """Begin some of them anew."""
        self.value[rows] = self.at_s[rows] = 0.0

    def see(self, value: np.ndarray, now_s: float) -> None:
        """Look at (n,) values."""
        more = value > self.value
        if more.any():
            self.value[more] = value[more]
            self.at_s[more] = now_s


class Watch:
    """Records largest speed under torque, torque and age of a command per motor, lowest height and last touch per arm.

    channels: all, in the order of the scene.
    """

    def __init__(self, world: World, channels: Sequence[Channel], clock: Clock):
        self._world, self._clock = world, clock
        self.on: set[str] = set()
        self._motors = {channel.name: [motor.name for motor in channel.motors] for channel in channels}
        self._all_motors = [motor for channel in channels for motor in channel.motors]
        ends = list(itertools.accumulate((len(channel.motors) for channel in channels), initial=0))
        # of each channel's motors in the arrays
        self._rows = {channel.name: slice(*ends[i : i + 2]) for i, channel in enumerate(channels)}
        actuators = [motor.drive.actuator for motor in self._all_motors]
        self._arm = {channel.name: index for index, channel in enumerate(channels)}
        geom_bodies = world.model.geom_bodyid.tolist()
        self._actuators = np.array(actuators)
        self._tools = np.array([world.model.site(f"{channel.name}/tcp_site").id for channel in channels])
        self._velocities, self._forces = world.data.actuator_velocity, world.data.actuator_force
        self._heights = world.data.site_xpos[:, 2]
        self._arm_of = np.array([self._arm.get(world.model.body(b).name.partition("/")[0], -1) for b in geom_bodies])
        count, arms = len(actuators), len(channels)
        self._enabled = np.zeros(count)  # 1 with torque, 0 without
        self._speed, self._torque, self._asked, self._age = (Largest(count) for _ in range(4))
        self._start_z, self._lowest_z = np.zeros(arms), np.full(arms, np.inf)
        self._touched_at = np.zeros(arms)
        self._changes: dict[str, deque[Change]] = {}
        self._started_s: dict[str, float] = {}
        self._next_s = 0.0

    def start(self, channel: str) -> None:
        """Record a channel, from now on and anew."""
        rows, arm = self._rows[channel], self._arm[channel]
        for largest in (self._speed, self._torque, self._asked, self._age):
            largest.forget(rows)
        mujoco.mj_kinematics(self._world.model, self._world.data)
        self._touched_at[arm] = 0.0
        self._start_z[arm] = self._lowest_z[arm] = self._heights[self._tools[arm]]
        self._changes[channel] = deque(maxlen=_CHANGES_KEPT)
        self._started_s[channel] = self._clock.now()
        self.on.add(channel)

    def knows(self, channel: str) -> bool:
        """Whether anything was ever recorded of it."""
        return channel in self._started_s

    def stop(self, channel: str) -> None:
        """Record it no longer; the record stays."""
        self.on.discard(channel)

    def note(self, channel: str, kind: str, motor: str, fault: int = 0) -> None:
        """Take an event of a motor: it was enabled, disabled, or entered a fault."""
        row = self._rows[channel].start + self._motors[channel].index(motor)
        before, now = bool(self._enabled[row]), kind == "motor_enabled"
        self._enabled[row] = now
        if channel in self.on:
            self._changes[channel].append(Change(self._clock.now(), motor, before != now, now, fault))

    def sample_torques(self) -> None:
        """Look at the step that was just simulated: a torque may last for only a few."""
        if self.on:
            now = self._world.stamp_s
            self._torque.see(np.abs(self._forces[self._actuators]), now)
            self._asked.see(np.abs(self._world.asked_nm(self._actuators)), now)

    def sample(self) -> None:
        """Look at the present state. Hot: 500 times a second while on."""
        world = self._world
        if world.sim_s < self._next_s:
            return
        self._next_s = world.sim_s + _PERIOD_S
        now = world.stamp_s
        speed = np.abs(self._velocities[self._actuators])
        speed *= self._enabled
        self._speed.see(speed, now)
        age = world.sim_s - np.array([motor.last_command_s for motor in self._all_motors])
        age *= self._enabled
        self._age.see(age, now)
        np.minimum(self._lowest_z, self._heights[self._tools], out=self._lowest_z)
        contact, count = world.data.contact, world.data.ncon
        near = np.flatnonzero(contact.dist[:count] <= 0.0)
        touching = self._arm_of[contact.geom[near]]  # (k, 2)
        itself = touching[:, 0] == touching[:, 1]
        arms = touching[~itself]
        self._touched_at[arms[arms >= 0]] = now
        for index, arm in zip(near[itself], touching[itself, 0], strict=True):
            if arm >= 0 and self._force_n(int(index)) > _PRESS_N:
                self._touched_at[arm] = now

    def _force_n(self, contact: int) -> float:
        wrench = np.zeros(6)
        mujoco.mj_contactForce(self._world.model, self._world.data, contact, wrench)
        return abs(float(wrench[0]))  # along the normal

    def report(self, channel: str, since: int, limit: int) -> dict[str, Any]:
        """The record, see `RigOperations.watch`; of the changes at most `limit` from number `since` on."""
        rows, arm = self._rows[channel], self._arm[channel]
        changes = list(self._changes[channel])[since : since + limit]
        return {
            "since_s": self._started_s[channel],
            "motors": self._motors[channel],
            "max_speed_rad_s": self._speed.value[rows],
            "max_speed_at_s": self._speed.at_s[rows],
            "max_torque_nm": self._torque.value[rows],
            "max_torque_at_s": self._torque.at_s[rows],
            "max_asked_nm": self._asked.value[rows],
            "max_asked_at_s": self._asked.at_s[rows],
            "max_command_age_s": self._age.value[rows],
            "min_tcp_z_m": self._lowest_z[arm],
            "max_tcp_drop_m": self._start_z[arm] - self._lowest_z[arm],
            "touched_at_s": self._touched_at[arm],
            "changes": len(changes),
            "enabled_events": [(row.at_s, row.motor, row.enabled) for row in changes if row.switched],
            "fault_events": [(row.at_s, row.motor, row.fault) for row in changes if row.fault],
        }
