"""The leader's side of one pair of arms: gate, target for the follower, and torques on the leader's joints.

The leader reads only the follower's published state. A state that is stale, or of an arm with a different number of
joints or motors, is ignored: the gate waits, no force acts, and the leader's own motion continues.
"""

import logging
import math
from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.arm.config import lead_of
from lerobot_robot_yam.arm.leaders.lead_config import check_leads
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.laws.bilateral import BilateralForce
from lerobot_robot_yam.control.laws.glide import SoftPull
from lerobot_robot_yam.control.teleop.follower_target import NEAR, TargetRamp, TriggerPickup
from lerobot_robot_yam.control.teleop.follower_view import FollowerView
from lerobot_robot_yam.control.teleop.gate import GateMachine, Look, SharedGate
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import channel_key
from lerobot_robot_yam.system.few_values import largest

logger = logging.getLogger(__name__)

_LEADS = (Mode.FLOAT, Mode.HOLD, Mode.TRACK)
_AGE_MOST_S = 0.03  # maximum age of a motor's sample
_HOME_RAD, _LEADER_HOME_RAD = 0.05, 0.1
_RECENTRED_RAD, _RECENTRE_RAD_S = 0.02, 0.15
# Speed and acceleration limits of a leader that mirrors its follower: above the motions of usual policies, so that the
# leader keeps up.
_MIRROR_RAD_S, _MIRROR_RAD_S2 = 2.0, 15.0
_AGREES_S = 1.0  # time for a gripper to reach the trigger's opening; longer: another source moves the gripper
_BUTTONS = {"top": 0, "bottom": 1}
_ALPHA, _BETA, _GAMMA = 0.2, 0.3, 0.1  # α, β and γ of `MotionFilter`, per tick of 250 Hz
_TICK_S = 0.004
_FADE_S, _FADED_NM = 0.02, 0.1  # time constant with which a force fades out, s, and torque below which it ends
_RESTART_S = 0.05  # pause after which the filter restarts


class MotionFilter:
    """Position and speed filter for n hand-moved joints: removes the encoders' quantisation with hardly any delay.

        q̂ += dq̂ Δt + α (q − q̂ − dq̂ Δt),   r = dq − dq̂ − ddq̂ Δt,   dq̂ += ddq̂ Δt + β r,   ddq̂ += γ r / Δt

    A motor reports its position in steps of 0.38 mrad and its speed in steps of 5 to 15 mrad/s. Unfiltered, each step
    causes a jerk of the follower. A position extrapolated with the speed has no lag while the speed is steady, nor has
    the speed while the acceleration is: without it, the speed was 14 ms late, and a follower went 8 % too far at 2 Hz.

    Attributes:
        q, dq: (n,) filtered position, rad, and speed, rad/s, at `stamp_s`.
    """

    def __init__(self, joints: int):
        self.q: np.ndarray = np.zeros(joints)
        self.dq: np.ndarray = np.zeros(joints)
        self._ddq: np.ndarray = np.zeros(joints)
        self.stamp_s = -np.inf

    def advance(self, q: np.ndarray, dq: np.ndarray, stamp_s: float) -> None:
        """Process a sample (n,) with timestamp `stamp_s`; ignore a sample that is not newer than the last one."""
        dt = stamp_s - self.stamp_s
        if dt <= 0.0:
            return
        self.stamp_s = stamp_s
        if dt > _RESTART_S:
            self.q, self.dq, self._ddq = q.copy(), dq.copy(), np.zeros_like(dq)
            return
        ticks = dt / _TICK_S
        ahead = self.q + self.dq * dt
        self.q = ahead + (1.0 - (1.0 - _ALPHA) ** ticks) * (q - ahead)
        ahead = self.dq + self._ddq * dt
        off = dq - ahead
        self.dq = ahead + (1.0 - (1.0 - _BETA) ** ticks) * off
        self._ddq = self._ddq + (1.0 - (1.0 - _GAMMA) ** ticks) / dt * off


class Lead:
    """Teleoperation side of one leader: computes the follower's target and the leader's force feedback.

    Args:
        arm: the leader.
        gate: the gate, which may be shared with another leader.
        index: index of this arm in the gate.

    Attributes:
        state: present state of the gate.
        action, action_dq: (m,) follower's target, gripper last, and the target's speed; None while there is no target.
        stamp_s: timestamp of the leader's sample from which `action` is computed, s.
        assist: torque and damping (joints,) on the leader in addition to gravity compensation; None: none.

    Raises:
        ConfigError: the follower's joint count differs from the leader's.
    """

    def __init__(self, arm: ResolvedArm, gate: SharedGate, index: int):
        config = lead_of(arm.config)
        assert config is not None
        config.check_joints(arm.name, arm.joints)
        follower, gripper = resolve_profiles(config.arm, config.gripper)
        if follower.joint_count != arm.joints:
            what = f"its follower, {config.arm}, has {follower.joint_count} joints, not {arm.joints}"
            raise ConfigError(f"{arm.name}: {what}")
        self._config, self._name, self._joints = config, arm.name, arm.joints
        self._gate, self._index = gate, index
        self._grips, self._own_gripper = gripper.motor is not None, arm.has_gripper
        low, high = follower.joint_limits_rad.T
        tail = [1.0] * self._grips
        self._lower, self._upper = np.append(low, [0.0] * self._grips), np.append(high, tail)
        home = np.zeros(arm.joints) if config.home_rad is None else np.array(config.home_rad)
        home = np.minimum(np.maximum(home, low), high)
        self._home = np.append(home, [config.home_gripper] * self._grips)
        self._counts = [joint - 1 for joint in config.gate_joints]
        key = channel_key(arm.config.interface, config.follower, arm.config.can_options.get("rig"))
        own = channel_key(arm.config.interface, arm.config.channel, arm.config.can_options.get("rig"))
        self._follower = FollowerView(arm.name, key, own, arm.joints, len(self._home))
        self._motion = MotionFilter(arm.joints)
        self._trigger = TriggerPickup()
        self._ramp = TargetRamp(config, self._home, self._lower, self._upper)
        self._led = SoftPull(arm.kp[: arm.joints], arm.kd[: arm.joints])
        self._mirror = SoftPull(arm.kp[: arm.joints], arm.kd[: arm.joints], _MIRROR_RAD_S2)
        self._mirrors = False
        gain = np.broadcast_to(np.array(config.bilateral, dtype=float), (arm.joints,))
        self._force = BilateralForce(gain, arm.kp[: arm.joints], arm.torque_limit_nm[: arm.joints])
        self._pulls = self._told_slow = False
        self._buttons = _BUTTONS.get(config.gate_button or ""), _BUTTONS.get(config.fine_button or "")
        self._down = [False, False]
        self._before_s = self._agreed_s = -math.inf
        self.state = gate.machine.state
        self._entered: Gate | None = None  # the state that the ramp has entered
        self.action: np.ndarray | None = None
        self.action_dq: np.ndarray | None = None
        self.stamp_s = math.nan
        self.assist: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def motors(self) -> int:
        """Number of the follower's motors, m."""
        return len(self._home)

    def advance(
        self,
        now: float,
        mode: Mode | None,
        sample: tuple[np.ndarray, np.ndarray, np.ndarray],
        handle: tuple[float, tuple[bool, bool], float],
        weight_nm: np.ndarray,
    ) -> None:
        """Process one tick.

        Args:
            now: time, s.
            mode: the leader's mode; None: the leader must not lead, because another arm is in fault.
            sample: q, dq and timestamps of the joints, (joints,) each or more.
            handle: trigger, buttons, and timestamp of the handle's newest report.
            weight_nm: (joints,) gravity torque on the leader.
        """
        dt, self._before_s = min(now - self._before_s, 0.02), now
        if self._own_gripper:
            handle = 1.0 - float(sample[0][-1]), handle[1], handle[2]
        q, dq, stamps = (part[: self._joints] for part in sample)
        told = stamps.tolist()
        stamp_s = max(told, default=-math.inf)
        if mode is None or mode not in _LEADS or not now - min(told, default=math.inf) < _AGE_MOST_S:
            self._give_nothing(mode)
            self._soften(None, mode, dt)
            return
        self._motion.advance(q + dq * (stamp_s - stamps), dq, stamp_s)
        there = self._follower.look(now)
        self._read_handle(handle[0], mode, now)
        self.state = self._gate.advance(now, self._index, self._look(handle, there, now))
        leader, rate = np.zeros(self.motors), np.zeros(self.motors)
        leader[: self._joints], rate[: self._joints] = self._motion.q, self._motion.dq
        if self._grips:
            leader[-1] = self._opening()
        if self.state is not self._entered:
            self._entered, self._pulls = self.state, False
            self._ramp.enter(self.state, now, leader, self._follower if there else None)
        self.action, self.action_dq = self._ramp.advance(
            self.state, now, dt, leader, rate, self._follower if there else None
        )
        self.stamp_s = self._motion.stamp_s
        self._soften(self._assist(mode, now, weight_nm, dt), mode, dt)

    def _give_nothing(self, mode: Mode | None) -> None:
        """Clear target and force, because the leader cannot lead or one of its motors is silent."""
        self.action = self.action_dq = None
        self.stamp_s = math.nan
        self._follower.follows = self._mirrors = False
        self._gate.miss(self._index)
        if mode not in _LEADS:
            self.state, self._entered = self._gate.restart(), None
            self._ramp.forget()

    def _read_handle(self, trigger: float, mode: Mode, now: float) -> None:
        if not (self._grips and self._follower.there):
            self._trigger.advance(trigger)
            return
        opening = float(self._follower.setpoint[-1])
        agrees = self._trigger.opening is None or abs(opening - self._trigger.opening) < NEAR
        if not self._follower.led_by_another or agrees:
            self._agreed_s = now
        by_another = self._goes_along or now - self._agreed_s > _AGREES_S
        if mode is not Mode.FLOAT or by_another:  # the trigger counts only while the leader leads
            self._trigger.leave(opening, trigger)
        else:
            self._trigger.advance(trigger)

    @property
    def _goes_along(self) -> bool:
        """Whether another source moves the follower, and this leader mirrors that motion."""
        return self._config.mirror and self._follower.led_by_another

    def _opening(self) -> float:
        """Return the target opening of the follower's gripper; before the trigger's first report, the present one."""
        if self._trigger.opening is not None:
            return self._trigger.opening
        return float(self._follower.setpoint[-1]) if self._follower.there else 1.0

    def _look(self, handle: tuple[float, tuple[bool, bool], float], there: bool, now: float) -> Look:
        pressed = [index is not None and handle[1][index] for index in self._buttons]
        edges = [down and not before for down, before in zip(pressed, self._down, strict=True)]
        self._down = pressed
        away = self._away_rad()
        if not there or self.action is None:
            return Look(away_rad=away, pressed=edges[0], fine_pressed=edges[1])
        j, follower, state = slice(self._joints), self._follower, self._gate.machine.state
        follower.judge(self.action)
        return Look(
            away_rad=away,
            home=state is Gate.HOMING and follower.follows and self._at_home(),
            gap_rad=largest(follower.q[j] - self.action[j]),
            follows=follower.follows,
            approached=self._ramp.approached(now),
            recentred=state is Gate.RECENTRE and largest(self._motion.q - self.action[j]) < _RECENTRED_RAD,
            pressed=edges[0],
            fine_pressed=edges[1],
        )

    def _away_rad(self) -> float:
        """Return the leader's distance from home, rad: maximum over `gate_joints`, or L2 norm if these are empty."""
        if not self._counts:
            return float(np.linalg.norm(self._motion.q - self._home[: self._joints]))
        return max(abs(float(self._motion.q[joint] - self._home[joint])) for joint in self._counts)

    def _at_home(self) -> bool:
        """Return whether leader and follower are at home."""
        home = self._home[: self._joints]
        follower = float(np.linalg.norm(self._follower.setpoint[: self._joints] - home))
        return follower < _HOME_RAD and largest(self._motion.q - home) < _LEADER_HOME_RAD

    def _assist(self, mode: Mode, now: float, weight_nm: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray] | None:
        j = slice(self._joints)
        mirrored, self._mirrors = self._mirrors, False
        if mode is Mode.FLOAT and self._goes_along:
            self._mirrors = True
            if not mirrored:
                self._mirror.begin(self._motion.q)
            return self._mirror.advance(self._follower.setpoint[j], _MIRROR_RAD_S, self._motion.q, dt)
        if mode is not Mode.FLOAT or not self._follower.coupled:
            return None
        if mirrored:
            self._pulls = False  # the last pull was the mirroring
        if not self._pulls:  # no force at the last tick, or a new state: start without a jolt
            self._led.begin(self._motion.q)
            self._force.engage(None if mirrored or self.assist is None else self.assist[0])
        if self.state is Gate.HOMING:
            return self._led.advance(self._home[j], self._config.homing_speed_rad_s, self._motion.q, dt)
        if self.state is Gate.RECENTRE:
            assert self.action is not None
            return self._led.advance(self.action[j], _RECENTRE_RAD_S, self._motion.q, dt)
        if self.state is not Gate.ENGAGED or not self._force.works:
            return None
        # Sample and command of an arm take about as long as each other, so the way round takes twice both ages.
        delay_s = 2.0 * (now - self._motion.stamp_s + self._follower.age_s(now))
        if self._force.adapt(delay_s, dt) and not self._told_slow:
            self._tell_slow(delay_s)
        error = self._follower.q_at(now) - (self._motion.q + self._motion.dq * (now - self._motion.stamp_s))
        return self._force.torque(error, self._motion.dq, weight_nm, dt), self._force.damping

    def _soften(self, assist: tuple[np.ndarray, np.ndarray] | None, mode: Mode | None, dt: float) -> None:
        """Set `assist`. If it ends while the leader floats, as when data are missing, the last torque fades out."""
        self._pulls = assist is not None
        if assist is None and self.assist is not None and mode is Mode.FLOAT:
            tau = self.assist[0] * (1.0 - dt / _FADE_S)
            assist = (tau, self.assist[1]) if largest(tau) > _FADED_NM else None
        self.assist = assist

    def _tell_slow(self, delay_s: float) -> None:
        """Log once that the delay reduces the gain of the force."""
        most, asked = self._force.gain_most, float(self._force.gain.max())
        if most < 0.9 * asked:
            self._told_slow = True
            logger.warning(
                "%s: force feedback (bilateral) reduced from %.2f to %.2f: from this leader to its follower and back "
                "takes %.0f ms, with which more would swing; use quicker CAN adapters, or find why answers are lost",
                *(self._name, asked, most, 1e3 * delay_s),
            )

    def note(self, record: np.ndarray) -> None:
        """Write gate state and follower's target into the leader's state record."""
        m = self.motors
        record["gate"], record["action_stamp_s"] = self.state, self.stamp_s
        record["action"][:m] = np.nan if self.action is None else self.action
        record["action_dq"][:m] = np.nan if self.action_dq is None else self.action_dq

    def close(self) -> None:
        """Close the follower's block. Idempotent."""
        self._follower.close()


def make_leads(arms: Sequence[ResolvedArm]) -> list[Lead | None]:
    """Create a `Lead` for each arm that has a follower, else None; leaders with `together` set share one gate.

    Raises:
        ConfigError: a follower cannot be led or has two leaders, or the configurations of a shared gate differ.
    """
    configs = [lead_of(arm.config) for arm in arms]
    check_leads([config for config in configs if config is not None])
    together = [index for index, config in enumerate(configs) if config is not None and config.together]
    shared: SharedGate | None = None
    leads: list[Lead | None] = []
    for index, (arm, config) in enumerate(zip(arms, configs, strict=True)):
        if config is None:
            leads.append(None)
        elif index in together:
            shared = shared or SharedGate(GateMachine(config), [arms[i].name for i in together])
            leads.append(Lead(arm, shared, together.index(index)))
        else:
            leads.append(Lead(arm, SharedGate(GateMachine(config), [arm.name]), 0))
    return leads
