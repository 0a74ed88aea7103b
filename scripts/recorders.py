"""Recorders in the rig's process, with which tests and the soak observe a driver in every physics step.

The watch records an arm's extremes, the truth the state of each motor's shaft. The first function that starts a
recorder loads this file into the rig (`RigOperations.load`). While a recorder is on for any channel, the physics is
simulated step by step.
"""

import bisect
import itertools
import random
from collections import deque
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.devices.thermometer import Thermometer
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.operation import number

if TYPE_CHECKING:
    from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations

STEP_S = 0.001  # time step of the physics
_STAMP_UNIT_S = 2e-4
_STAMP_DIGIT = 84  # °C: below the warning limit of our thermal monitor, so that no stamp is taken for heat
_STAMP_WRAP = _STAMP_DIGIT**2
_PERIOD_S = 0.002  # minimum simulated time between two samples of the watch
_PRESS_N = 50.0  # minimum contact force between parts of one arm; a folded limp arm's wrist presses with 27 N
_CHANGES_PER_ANSWER = 500
_TRUTH_PER_ANSWER = 100
_TRUTH_MAX_S = 120.0
_COLUMNS = ("stamp_s", "q", "dq", "torque_nm", "asked_nm")
_SWITCHES = ("motor_enabled", "motor_disabled", "motor_fault")


def watch_start(rig: "RigOperations", channel: str) -> None:
    """Reset and start recording the arm's extremes, which `watch` returns."""
    rig.load(__file__)
    rig.request("watch_start", channel=channel)


def watch(rig: "RigOperations", channel: str) -> dict[str, Any]:
    """Return the extremes since `watch_start`, sampled every 2 to 4 ms of simulated time, torques every millisecond.

    Returns:
        since_s: monotonic time of the start. motors: n names, gripper last.
        max_speed_rad_s: (n,) maximum speed of motors while enabled; max_speed_at_s: monotonic times (0: none yet).
        max_torque_nm: (n,) maximum torque magnitudes at the joint (gripper: at the motor).
        max_asked_nm: (n,) maximum torque commanded before the motor's own limit; max_asked_at_s: monotonic times.
        max_command_age_s: (n,) maximum simulated time for which an enabled motor acted on one command.
        max_tcp_drop_m: maximum drop of the tool below its height at the start.
        touched_at_s: time at which the arm last touched another body, or itself with more than 50 N (0: never).
        enabled_events: (monotonic_s, motor, enabled) of each change. fault_events: (monotonic_s, motor, code).
    """
    found = rig.request("watch", channel=channel)
    while len(chunk := rig.request("watch_changes", channel=channel, since=len(found["changes"]))["changes"]):
        found["changes"] += chunk
    changes = found.pop("changes")
    found["enabled_events"] = [(at_s, motor, on) for at_s, motor, switched, on, _ in changes if switched]
    found["fault_events"] = [(at_s, motor, fault) for at_s, motor, _, _, fault in changes if fault]
    return found


def truth_start(rig: "RigOperations", channel: str, seconds: float = 1.0) -> None:
    """Reset and start keeping the last seconds (at most 120) of the channel's true shaft states, for `truth`."""
    rig.load(__file__)
    rig.request("truth_start", channel=channel, seconds=seconds)


def truth_stop(rig: "RigOperations", channel: str) -> None:
    """Stop keeping the channel's true shaft states."""
    rig.load(__file__)
    rig.request("truth_stop", channel=channel)


def truth(rig: "RigOperations", channel: str, after_s: float = 0.0) -> dict[str, np.ndarray]:
    """Return the true states of the shafts of the channel's n motors, one row per physics step (1 ms), oldest first.

    Args:
        after_s: only later rows are returned, monotonic s.

    Returns:
        stamp_s: (k,) monotonic. q, dq: (k, n) at that time, joint sign, gripper at the motor. torque_nm: (k, n)
        applied by the motors in the step before. asked_nm: (k, n) commanded in the step before,
        kp (q* − q) + kd (dq* − dq) + tau, without the motors' own limits.
    """
    rows: list[Any] = []
    while chunk := rig.request("truth", channel=channel, after_s=after_s)["samples"]:
        rows += chunk
        after_s = chunk[-1][0]
    columns = zip(*rows, strict=True) if rows else [()] * len(_COLUMNS)
    return dict(zip(_COLUMNS, map(np.array, columns), strict=True))


def stamp_temperatures(rig: "RigOperations") -> None:
    """Make all motors encode each sample's time in the temperature bytes from now on, see `sample_age_s`."""
    rig.load(__file__)
    rig.request("stamp_temperatures")


def sample_age_s(temp_mos: int, temp_rotor: int, now_s: float) -> float:
    """Return the age of a feedback sample whose temperature bytes contain its time, see `stamp_temperatures`.

    Unambiguous up to 1.4 s; accurate to 0.1 ms.
    """
    stamp = int(temp_mos) * _STAMP_DIGIT + int(temp_rotor) + 0.5
    return (now_s / _STAMP_UNIT_S - stamp) % _STAMP_WRAP * _STAMP_UNIT_S


def stamped_bytes(sample_s: float) -> tuple[int, int]:
    """Return the temperature bytes that encode the sample's monotonic time, s, for `sample_age_s`."""
    return divmod(int(sample_s / _STAMP_UNIT_S) % _STAMP_WRAP, _STAMP_DIGIT)


def beyond_clip_nm(
    seen: dict[str, np.ndarray], kp: np.ndarray, kd: np.ndarray, clip_nm: np.ndarray, known_s: np.ndarray | float
) -> np.ndarray:
    """Return the maximum torque, Nm, commanded beyond its clip for each of the first n motors; 0 if never beyond.

    A command that keeps to the clip for a state of up to `known_s` ago exceeds the clip where the joint has moved
    since, by  kp (q before − q now) + kd (dq before − dq now), which no driver can know. Each torque is judged with the
    state in this span that explains the torque best.

    Args:
        seen: result of `truth`, steps of 1 ms.
        kp, kd: (n,) gains of the commands, Nm/rad and Nm s/rad.
        clip_nm: (n,) Nm.
        known_s: (n,) or one value for all, s.
    """
    n = len(clip_nm)
    q, dq, asked = (seen[key].reshape(len(seen["stamp_s"]), -1)[:, :n] for key in ("q", "dq", "asked_nm"))
    lags = np.broadcast_to(np.round(np.asarray(known_s) / STEP_S).astype(int), n)
    beyond = np.abs(asked) - clip_nm
    for lag in range(1, min(int(lags.max(initial=0)), len(q) - 1) + 1):
        moved = kp * (q[:-lag] - q[lag:]) + kd * (dq[:-lag] - dq[lag:])
        explained = np.where(lag <= lags, np.abs(asked[lag:] - moved) - clip_nm, np.inf)
        beyond[lag:] = np.minimum(beyond[lag:], explained)
    largest: np.ndarray = beyond.max(axis=0, initial=0.0)
    return largest


def install(device: RigDevice) -> None:
    """Add the operations of both recorders to a rig."""
    asked = Asked(device)
    Watch(device, asked)
    Truth(device, asked)

    def stamp() -> None:
        for channel in device.channels.values():
            for motor in channel.motors:
                motor.thermometer = StampedThermometer(random.Random(0))

    device.operations["stamp_temperatures"] = stamp


class StampedThermometer(Thermometer):
    """Thermometer that reports each sample's time instead of temperatures."""

    held = property(lambda self: (0.0, 0.0), lambda self, value: None)  # never None, or `WholeTick` would bypass `read`

    def read(self, velocity_rad_s: float, torque_nm: float, sim_s: float, sample_s: float) -> tuple[int, int]:
        return stamped_bytes(sample_s)


class Asked:
    """Commanded torques of the last step: kp (u* − u) + kd (u̇* − u̇) + tau."""

    def __init__(self, device: RigDevice):
        self._world = device.world
        self._steps, self._nm = -1, np.zeros(device.world.model.nu)

    def nm(self) -> np.ndarray:
        """Return the torques (nu,), Nm, before the motors' own limits."""
        world = self._world
        if self._steps != world.steps:  # both recorders call this method
            data, bias = world.data, world.model.actuator_biasprm
            self._nm = data.ctrl + bias[:, 1] * data.actuator_length + bias[:, 2] * data.actuator_velocity
            self._steps = world.steps
        return self._nm


class Largest:
    """Maximum of each of n values so far, and the time at which it was reached."""

    def __init__(self, count: int):
        self.value, self.at_s = np.zeros(count), np.zeros(count)

    def see(self, value: np.ndarray, now_s: float, rows: np.ndarray) -> None:
        """Update with values (n,), of which only `rows` (n,) bool are used."""
        more = (value > self.value) & rows
        if more.any():
            self.value[more] = value[more]
            self.at_s[more] = now_s


class Watch:
    """Records maximum speed while enabled, torque and command age per motor, and minimum height and last touch per arm.

    Torques are sampled in every step, the rest after every advance (at most 4 ms), in one pass over all motors.
    """

    def __init__(self, device: RigDevice, asked: Asked):
        self._device, self._world, self._asked_now = device, device.world, asked
        world, channels = device.world, [device.channels[row.channel] for row in device.scene.arms]
        self._all_motors = [motor for channel in channels for motor in channel.motors]
        ends = list(itertools.accumulate((len(channel.motors) for channel in channels), initial=0))
        self._rows = {channel.name: slice(*ends[i : i + 2]) for i, channel in enumerate(channels)}  # rows of its motors
        self._actuators = np.array([motor.drive.actuator for motor in self._all_motors])
        self._arm = {channel.name: index for index, channel in enumerate(channels)}
        self._tools = np.array([world.model.site(f"{channel.name}/tcp_site").id for channel in channels])
        bodies = [world.model.body(body).name for body in world.model.geom_bodyid.tolist()]
        self._arm_of = np.array([self._arm.get(body.partition("/")[0], -1) for body in bodies])  # geom → arm or −1
        count, arms = len(self._actuators), len(channels)
        self._speed, self._torque, self._asked, self._age = (Largest(count) for _ in range(4))
        self._start_z, self._lowest_z = np.zeros(arms), np.full(arms, np.inf)
        self._touched_at = np.zeros(arms)
        self._started: dict[str, dict[str, Any]] = {}  # channel → time, number of the next event, enabled motors
        self._on = np.zeros(count, bool)  # motors of the channels that are recorded
        self._next_s = 0.0
        device.operations |= {
            "watch_start": self.start,
            "watch": self.report,
            "watch_changes": self.changes,
        }

    def start(self, channel: str) -> None:
        """Reset and start recording a channel."""
        rows, arm = self._rows[channel], self._arm[channel]
        for largest in (self._speed, self._torque, self._asked, self._age):
            largest.value[rows] = largest.at_s[rows] = 0.0
        mujoco.mj_kinematics(self._world.model, self._world.data)
        self._touched_at[arm] = 0.0
        self._start_z[arm] = self._lowest_z[arm] = self._world.data.site_xpos[self._tools[arm], 2]
        self._started[channel] = {
            "since_s": self._device.clock.now(),
            "event": self._device.events.next_number,
            "enabled": {motor.name: motor.enabled for motor in self._device.channels[channel].motors},
        }
        self._on[rows] = True
        if self._sample_torques not in self._device.each_step:
            self._device.each_step.append(self._sample_torques)
            self._device.each_advance.append(self._sample)

    def _sample_torques(self) -> None:
        """Sample the step just simulated, because a torque may last for only a few steps."""
        now, force = self._world.stamp_s, self._world.data.actuator_force
        self._torque.see(np.abs(force[self._actuators]), now, self._on)
        self._asked.see(np.abs(self._asked_now.nm()[self._actuators]), now, self._on)

    def _sample(self) -> None:
        """Sample the current state."""
        world, data = self._world, self._world.data
        if world.sim_s < self._next_s:
            return
        self._next_s = world.sim_s + _PERIOD_S
        now = world.stamp_s
        enabled = np.array([motor.enabled for motor in self._all_motors])
        self._speed.see(np.abs(data.actuator_velocity[self._actuators]) * enabled, now, self._on)
        age = world.sim_s - np.array([motor.last_command_s for motor in self._all_motors])
        self._age.see(age * enabled, now, self._on)
        np.minimum(self._lowest_z, data.site_xpos[self._tools, 2], out=self._lowest_z)
        near = np.flatnonzero(data.contact.dist[: data.ncon] <= 0.0)
        touching = self._arm_of[data.contact.geom[near]]  # (k, 2)
        itself = touching[:, 0] == touching[:, 1]
        arms = touching[~itself]
        self._touched_at[arms[arms >= 0]] = now
        for index, arm in zip(near[itself], touching[itself, 0], strict=True):
            if arm >= 0 and self._force_n(int(index)) > _PRESS_N:
                self._touched_at[arm] = now

    def _force_n(self, contact: int) -> float:
        wrench = np.zeros(6)
        mujoco.mj_contactForce(self._world.model, self._world.data, contact, wrench)
        return abs(float(wrench[0]))  # normal force

    def report(self, channel: str) -> dict[str, Any]:
        """Return the record without its changes."""
        if channel not in self._started:
            raise ConfigError(f"{channel} is not watched; call watch_start first")
        rows, arm = self._rows[channel], self._arm[channel]
        return {
            "since_s": self._started[channel]["since_s"],
            "motors": [motor.name for motor in self._all_motors[rows]],
            "max_speed_rad_s": self._speed.value[rows],
            "max_speed_at_s": self._speed.at_s[rows],
            "max_torque_nm": self._torque.value[rows],
            "max_asked_nm": self._asked.value[rows],
            "max_asked_at_s": self._asked.at_s[rows],
            "max_command_age_s": self._age.value[rows],
            "max_tcp_drop_m": self._start_z[arm] - self._lowest_z[arm],
            "touched_at_s": self._touched_at[arm],
            "changes": [],
        }

    def changes(self, channel: str, since: int) -> dict[str, Any]:
        """Return up to 500 changes from number `since` on: time, motor, whether switched, whether enabled, fault."""
        started, found = self._started[channel], []
        enabled = dict(started["enabled"])
        for event in self._device.events.since(started["event"]):
            if event["kind"] in _SWITCHES and event["channel"] == channel:
                motor, on = event["motor"], event["kind"] == "motor_enabled"
                found.append((event["monotonic_s"], motor, enabled[motor] != on, on, event.get("fault", 0)))
                enabled[motor] = on
        return {"changes": found[since : since + _CHANGES_PER_ANSWER]}


class Truth:
    """Keeps the last seconds of world states, one sample per step, while recording is on for any channel."""

    def __init__(self, device: RigDevice, asked: Asked):
        self._device, self._world, self._asked = device, device.world, asked
        self._seconds: dict[str, float] = {}
        self._since_s: dict[str, float] = {}
        self._kept: deque[tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = deque()
        device.operations |= {"truth_start": self.start, "truth_stop": self.stop, "truth": self.report}

    def start(self, channel: str, seconds: float) -> None:
        """Reset and start keeping the last seconds of a channel."""
        self._seconds[channel], self._since_s[channel] = number(seconds, 0.001, _TRUTH_MAX_S), self._world.stamp_s
        self._resize()

    def stop(self, channel: str) -> None:
        """Stop keeping states of a channel."""
        self._seconds.pop(channel, None)
        self._resize()

    def _resize(self) -> None:
        longest_s = max(self._seconds.values(), default=0.0)
        self._kept = deque(self._kept, maxlen=round(longest_s / self._world.timestep_s))
        looks = self._device.each_step
        if self._sample in looks:
            looks.remove(self._sample)
        if self._seconds:
            looks.append(self._sample)

    def _sample(self) -> None:
        """Store the current state, and the torques of the step before."""
        world, data = self._world, self._world.data
        state = data.qpos.copy(), data.qvel.copy(), data.actuator_force.copy()
        self._kept.append((world.stamp_s, *state, self._asked.nm()))

    def report(self, channel: str, after_s: float) -> dict[str, Any]:
        """Return the oldest samples later than `after_s`."""
        if channel not in self._seconds:
            raise ConfigError(f"{channel}: the truth is not recorded; call truth_start first")
        after_s = max(after_s, self._since_s[channel])
        begin = bisect.bisect_right(self._kept, after_s, key=lambda sample: sample[0])
        rows = list(itertools.islice(self._kept, begin, begin + _TRUTH_PER_ANSWER))
        if not rows:
            return {"samples": []}
        stamps, qpos, qvel, force, asked = (np.array(column) for column in zip(*rows, strict=True))
        drives = [motor.drive for motor in self._device.channels[channel].motors]
        angles = [drive.base_rad + drive.coefficient * qpos[:, drive.q].sum(axis=1) for drive in drives]
        rates = [drive.coefficient * qvel[:, drive.v].sum(axis=1) for drive in drives]
        actuators = [drive.actuator for drive in drives]
        columns = (stamps, np.transpose(angles), np.transpose(rates), force[:, actuators], asked[:, actuators])
        return {"samples": [list(row) for row in zip(*(column.tolist() for column in columns), strict=True)]}
