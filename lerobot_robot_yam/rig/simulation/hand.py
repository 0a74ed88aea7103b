"""A hand on a leader arm: it pulls the joints along a trajectory, with limited force, and squeezes the trigger.

The pull is a damped spring at each joint, integrated with the physics; the arm's own motors work against or with it.
As a person would, the hand lets go of an arm that works against it, as one does that lands.
"""

import bisect
import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from lerobot_robot_yam.rig.world.mechanics import Drive
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import HAND_KD, HAND_KP

_PERIOD_S = 0.002  # of the target's interpolation
# A joint's way to a path that begins elsewhere: faster than the planner's paths (1.2), slower than a fall (3). A path
# begins elsewhere when the simulated clock slipped, or when a floating arm moved after its mover had looked at it.
_JOIN_RAD_S = 2.0
_RESIST_NM = 2.5  # a leader that floats takes less than 1 Nm at any joint
_RESIST_S = 0.4  # shorter peaks are the jerk of starting and stopping


class Hand:
    """The operator's hand on the leader of a channel, and on its handle encoder if it has one."""

    def __init__(self, world: World, channel: str, handle: SimHandle | None):
        self._world = world
        self._handle = handle
        count = world.profiles[channel][0].joint_count
        self._addresses = world.joint_addresses(channel)
        self._drives = [Drive(world, channel, f"hand_{i + 1}", (f"joint{i + 1}",), 0.0, 1.0) for i in range(count)]
        self._actuators = [drive.actuator for drive in self._drives]
        self._start_s = 0.0
        # Plain lists, as `advance` takes single numbers from them. Each row: the joints, then the trigger.
        self._times: list[float] = [0.0]
        self._path: list[list[float]] = [[0.0] * (count + 1)]
        self._rates: list[list[float]] = self._path
        self._targets = self._path[0][:count]  # of the joints, at `_advanced_s`
        self._advanced_s = self._next_s = 0.0
        self.gripping = False
        self.resisted = False  # the arm worked against the hand; it takes hold again once the arm was limp
        self._easy_s = 0.0  # when the arm last gave way

    def move(self, times_s: Sequence[float], q_rad: Sequence[Sequence[float]], trigger: Sequence[float]) -> None:
        """Grip and pull from where the hand is along q_rad (k, n) at times_s (k,) from now, then hold the last.

        A hand that takes hold is where the arm is. Joints that are elsewhere than q_rad join it at `_JOIN_RAD_S`.
        trigger (k,): 0 released … 1 squeezed.

        Raises:
            ConfigError: shapes do not fit, times do not increase, or a value is not finite.
        """
        times, joints = np.asarray(times_s, float), np.asarray(q_rad, float)
        count = len(self._drives)
        squeeze = np.broadcast_to(np.asarray(trigger, float), times.shape)
        if times.ndim != 1 or len(times) < 1 or joints.shape != (len(times), count):
            raise ConfigError(f"a hand needs times (k,) and joints (k, {count}), not {times.shape} and {joints.shape}")
        path = np.column_stack([joints, squeeze])
        arm = [self._world.qpos[address] for address in self._addresses]
        if times[0] > 0.0:
            here = [*(self._targets if self.gripping else arm), path[0, -1]]
            times, path = np.insert(times, 0, 0.0), np.insert(path, 0, here, axis=0)
        if (np.diff(times) <= 0).any() or not np.isfinite(times).all() or not np.isfinite(path).all():
            raise ConfigError("a hand needs increasing times and finite values")
        rates = np.zeros_like(path)
        if len(times) > 1:
            rates[:-1] = np.diff(path, axis=0) / np.diff(times)[:, None]
        self._times, self._path, self._rates = times.tolist(), path.tolist(), rates.tolist()
        self._start_s = self._next_s = self._world.sim_s
        if not self.gripping:
            self._easy_s, self._advanced_s = self._start_s, self._start_s - _PERIOD_S
            self._targets = arm
        self.gripping = not self.resisted
        if self.gripping:
            for drive in self._drives:
                drive.set_gains(HAND_KP, HAND_KD)

    def release(self) -> None:
        """Let go; the trigger springs back."""
        self.gripping = False
        for drive in self._drives:
            drive.command(0.0, 0.0, 0.0, 0.0, 0.0)
        if self._handle is not None:
            self._handle.trigger = self._handle.trigger_rate = 0.0

    def advance(self, energised: bool) -> None:
        """Follow the trajectory; call at least every few milliseconds of simulated time.

        A limp arm (not `energised`) is heavy, which is no resistance.
        """
        now = self._world.sim_s
        if not self.gripping or now < self._next_s:
            return
        self._next_s = now + _PERIOD_S
        force, actuators = self._world.force, self._actuators
        if not energised or all([abs(force[actuator]) < _RESIST_NM for actuator in actuators]):
            self._easy_s = now
        elif now - self._easy_s > _RESIST_S:
            self.resisted = True
            self.release()
            return
        t = now - self._start_s
        index = bisect.bisect_right(self._times, t) - 1
        row = max(index, 0)
        ahead = t - self._times[row] if index >= 0 else 0.0
        rates = self._rates[row].copy()
        targets = [start + rate * ahead for start, rate in zip(self._path[row], rates, strict=True)]
        elapsed, self._advanced_s = now - self._advanced_s, now
        for joint, here in enumerate(self._targets):
            way, speed = targets[joint] - here, max(_JOIN_RAD_S, abs(rates[joint]))
            if abs(way) > speed * elapsed:
                rates[joint] = math.copysign(speed, way)
                targets[joint] = here + rates[joint] * elapsed
        self._targets = targets[: len(actuators)]
        pull = [HAND_KP * target + HAND_KD * rate for target, rate in zip(self._targets, rates, strict=False)]
        self._world.data.ctrl[actuators] = pull
        if self._handle is not None:
            self._handle.trigger = min(max(targets[-1], 0.0), 1.0)
            self._handle.trigger_rate = rates[-1]
