"""Records that the rig itself takes, by which tests and soaks judge a driver without missing a tick.

`Watch` keeps the extremes of the arms, `TruthRecorder` the true state of each motor's shaft in every step of the
physics. Both are off by default. While either is on for any channel, the physics is simulated step by step.
"""

import bisect
import itertools
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.world.shafts_and_masses import Drive
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.system.clock import Clock

_PERIOD_S = 0.002  # simulated time between two looks, at least
_CHANGES_KEPT = 50_000
_PRESS_N = 50.0  # of an arm on itself, at a point; the wrist of a folded limp arm presses with 27
STEP_S = 0.001  # of the physics
_Sample = tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


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

    Torques are looked at in every step, the rest after every advance (at most 4 ms), in one pass over all motors.
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
        self._actuators = np.array([motor.drive.actuator for motor in self._all_motors])
        self._arm = {channel.name: index for index, channel in enumerate(channels)}
        self._tools = np.array([world.model.site(f"{channel.name}/tcp_site").id for channel in channels])
        self._velocities, self._forces = world.data.actuator_velocity, world.data.actuator_force
        self._heights = world.data.site_xpos[:, 2]
        bodies = [world.model.body(body).name for body in world.model.geom_bodyid.tolist()]
        self._arm_of = np.array([self._arm.get(body.partition("/")[0], -1) for body in bodies])  # of a geom; −1: no arm
        count, arms = len(self._actuators), len(channels)
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
            self._asked.see(np.abs(self._world.asked_nm()[self._actuators]), now)

    def sample(self) -> None:
        """Look at the present state. Hot: 500 times a second while on."""
        world = self._world
        if world.sim_s < self._next_s:
            return
        self._next_s = world.sim_s + _PERIOD_S
        now = world.stamp_s
        self._speed.see(np.abs(self._velocities[self._actuators]) * self._enabled, now)
        age = world.sim_s - np.array([motor.last_command_s for motor in self._all_motors])
        self._age.see(age * self._enabled, now)
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


class TruthRecorder:
    """Keeps the last seconds of the world, one sample per step, while it is on for any channel."""

    def __init__(self, world: World, channels: Iterable[Channel]):
        self._world = world
        self._drives: dict[str, list[Drive]] = {
            channel.name: [motor.drive for motor in channel.motors if isinstance(motor.drive, Drive)]
            for channel in channels
        }
        self._seconds: dict[str, float] = {}
        self._since_s: dict[str, float] = {}
        self._kept: deque[_Sample] = deque()

    @property
    def on(self) -> bool:
        """Whether `sample` must be called after each step."""
        return bool(self._seconds)

    def start(self, channel: str, seconds: float) -> None:
        """Keep the last seconds of a channel, from now on and anew."""
        self._seconds[channel], self._since_s[channel] = seconds, self._world.stamp_s
        self._resize()

    def stop(self, channel: str) -> None:
        """Keep nothing of it."""
        self._seconds.pop(channel, None)
        self._resize()

    def _resize(self) -> None:
        longest_s = max(self._seconds.values(), default=0.0)
        self._kept = deque(self._kept, maxlen=round(longest_s / self._world.timestep_s))

    def knows(self, channel: str) -> bool:
        """Whether it is kept."""
        return channel in self._seconds

    def sample(self) -> None:
        """Keep the present state, and the torques of the step before it."""
        if self._seconds:
            world, data = self._world, self._world.data
            state = data.qpos.copy(), data.qvel.copy(), data.actuator_force.copy()
            self._kept.append((world.stamp_s, *state, world.asked_nm()))

    def report(self, channel: str, after_s: float, limit: int) -> dict[str, Any]:
        """The oldest `limit` samples later than `after_s`, see `RigOperations.truth`."""
        after_s = max(after_s, self._since_s[channel])
        begin = bisect.bisect_right(self._kept, after_s, key=lambda sample: sample[0])
        rows = list(itertools.islice(self._kept, begin, begin + limit))
        if not rows:
            return {"samples": []}
        stamps, qpos, qvel, force, asked = (np.array(column) for column in zip(*rows, strict=True))
        drives = self._drives[channel]
        angles, rates = zip(*(drive.read(qpos, qvel) for drive in drives), strict=True)
        actuators = [drive.actuator for drive in drives]
        columns = (stamps, np.transpose(angles), np.transpose(rates), force[:, actuators], asked[:, actuators])
        return {"samples": [list(row) for row in zip(*(column.tolist() for column in columns), strict=True)]}


def beyond_clip_nm(
    truth: dict[str, np.ndarray], kp: np.ndarray, kd: np.ndarray, clip_nm: np.ndarray, known_s: np.ndarray | float
) -> np.ndarray:
    """The largest torque in Nm that commands asked of each of the first n motors beyond its clip; 0 if all kept to it.

    A command that keeps to the clip by a state of up to `known_s` ago asks for more where the joint has moved since,
    by  kp (q before − q now) + kd (dq before − dq now). No driver can know that. Of those states the one that explains
    a torque best is taken for the one that the driver knew.

    Args:
        truth: of `RigOperations.truth`, steps of 1 ms.
        kp, kd: (n,) gains of the commands, Nm/rad and Nm s/rad.
        clip_nm: (n,) Nm.
        known_s: (n,) or one for all, s.
    """
    n = len(clip_nm)
    q, dq, asked = (truth[key].reshape(len(truth["stamp_s"]), -1)[:, :n] for key in ("q", "dq", "asked_nm"))
    lags = np.broadcast_to(np.round(np.asarray(known_s) / STEP_S).astype(int), n)
    beyond = np.abs(asked) - clip_nm
    for lag in range(1, min(int(lags.max(initial=0)), len(q) - 1) + 1):
        moved = kp * (q[:-lag] - q[lag:]) + kd * (dq[:-lag] - dq[lag:])
        explained = np.where(lag <= lags, np.abs(asked[lag:] - moved) - clip_nm, np.inf)
        beyond[lag:] = np.minimum(beyond[lag:], explained)
    largest: np.ndarray = beyond.max(axis=0, initial=0.0)
    return largest
