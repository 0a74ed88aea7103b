"""The operator's world without processes and without waiting: real physics, a short stand-in for the control loops.

Leaders float on exact gravity compensation and are pulled by the rig's own force-limited hands; followers track them
with the profile's gains, gravity feed-forward and speed limits. In a scene without leaders the hands' paths are the
followers' targets.
"""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lerobot_robot_yam.mobile.base_motion import BaseLimits, BaseMotion
from lerobot_robot_yam.mobile.base_target import Target
from lerobot_robot_yam.rig.operator.hands import Sight, sight_of
from lerobot_robot_yam.rig.scene.scene import Scene
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.rig_operations import perform
from lerobot_robot_yam.rig.world.world_model import HAND_KD, HAND_KP
from tests.support.transfers import Transfers

TICK_STEPS = 4
LAG_TICKS = 8  # of LeRobot at 30 Hz between leader and follower
WHEEL_KD = 20.0
GRIP_TORQUE_NM = 1.0  # what the force limiter lets through


def described(scene: Scene) -> dict:
    """The scene in the form in which a rig describes itself to its clients."""
    return json.loads(json.dumps(perform(RigDevice(scene), {"op": "scene"}), default=np.ndarray.tolist))


class StandIn:
    """Implements `hands.Hands` in simulated time, which runs as fast as it can."""

    def __init__(self, scene: Scene, sides: tuple[str, ...] = ("left", "right")):
        self.device = RigDevice(scene)
        self.world, self.judge, self.prop = self.device.world, self.device.judge, scene.props[0].name
        self.transfers = Transfers(self.world)
        self.events: list[dict] = []
        self.energised = True
        self.following = True
        self._sides = sides
        self._paths: dict = {}
        self._history: dict = {side: [] for side in sides}
        model = self.world.model
        self._speed: dict = {}
        self._setpoint: dict = {}
        self._opening = dict.fromkeys(sides, 1.0)
        for side in sides:
            arm, gripper = self.world.profiles[f"follower_{side}"]
            channel = f"follower_{side}"
            for kp, kd, motor in zip(arm.kp, arm.kd, arm.motors, strict=True):
                self._gains(f"{channel}/{motor.name}", kp, kd)
            assert gripper.motor is not None
            self._gains(f"{channel}/{gripper.motor.name}", gripper.motor.kp, gripper.motor.kd)
            model.actuator(f"{channel}/{gripper.motor.name}").forcerange = (-GRIP_TORQUE_NM, GRIP_TORQUE_NM)
            self._setpoint[side] = self._q(channel)
            self._speed[side] = arm.speed_limit_rad_s
        self._motion = BaseMotion(self.world.base, BaseLimits())
        self._velocity = np.zeros(3)
        base = scene.base and scene.base.channel
        self._wheels = [f"{base}/{motor.name}" for motor in self.world.base.motors()] if base else []
        for wheel in self._wheels:
            self._gains(wheel, 0.0, WHEEL_KD)
        self.max_hand_nm = 0.0
        self.before_tick: Callable[[], None] | None = None

    def _gains(self, actuator: str, kp: float, kd: float) -> None:
        self.world.model.actuator(actuator).biasprm[1:3] = -kp, -kd

    def _q(self, channel: str) -> np.ndarray:
        return self.world.data.qpos[self.world.joint_addresses(channel)].copy()

    def now(self) -> float:
        return self.world.sim_s

    def wait(self, seconds: float) -> None:
        end = self.now() + seconds
        while self.now() < end - 1e-9:
            self._tick()

    def look(self) -> Sight:
        state = perform(self.device, {"op": "state", "brief": True})
        return replace(sight_of(state, self._sides), willing=self.energised)

    def _led_by(self, side: str) -> str:
        return f"leader_{side}" if f"leader_{side}" in self.world.profiles else f"follower_{side}"

    def pull(self, side: str, times_s: np.ndarray, q_rad: np.ndarray, trigger: np.ndarray) -> None:
        self._paths[side] = (self.now(), times_s, q_rad, trigger)

    def drive(self, velocity: np.ndarray) -> None:
        self._velocity = velocity

    def let_go(self) -> None:
        self._paths.clear()

    def put_back(self, position_m: np.ndarray) -> None:
        perform(self.device, {"op": "place", "prop": self.prop, "pos": position_m.tolist()})
        self.transfers.reset()

    @property
    def held(self) -> bool:
        """Whether a hand is on a leader."""
        return bool(self._paths)

    def _tick(self) -> None:
        if self.before_tick is not None:
            self.before_tick()
        data, dt = self.world.data, TICK_STEPS * self.world.timestep_s
        for side in self._sides:
            follower = f"follower_{side}"
            self._compensate_gravity(follower)
            history = self._history[side]
            history.append(self._lead(side))
            if not self.following:
                continue
            target, squeeze = history[max(0, len(history) - 1 - LAG_TICKS)]
            step = np.clip(target - self._setpoint[side], -self._speed[side] * dt, self._speed[side] * dt)
            self._setpoint[side] = self._setpoint[side] + step
            arm, gripper = self.world.profiles[follower]
            for i, motor in enumerate(arm.motors):
                command = arm.kp[i] * self._setpoint[side][i] + arm.kd[i] * step[i] / dt
                data.actuator(f"{follower}/{motor.name}").ctrl = command
            motor, calibration = gripper.motor, gripper.calibration
            most = motor.speed_limit_per_s * dt
            self._opening[side] += float(np.clip(1.0 - squeeze - self._opening[side], -most, most))
            closed, opened = calibration.nominal_stops_rad
            # Actuator length counts from the closed stop.
            data.actuator(f"{follower}/{motor.name}").ctrl = motor.kp * self._opening[side] * (opened - closed)
        if self._wheels:
            self._turn_wheels(dt)
        self.world.step(TICK_STEPS)
        self.events += self.judge.update() + self.transfers.update(self.world.sim_s)

    def _turn_wheels(self, dt: float) -> None:
        joints = [self.world.data.joint(wheel) for wheel in self._wheels]
        steer = np.array([joint.qpos[0] for joint in joints[::2]])
        self._motion.measure(steer, np.array([joint.qvel[0] for joint in joints]), dt)
        rates = self._motion.advance(Target(self._velocity), steer, dt)
        for wheel, rate in zip(self._wheels, rates, strict=True):
            self.world.data.actuator(wheel).ctrl = WHEEL_KD * rate

    def _lead(self, side: str) -> tuple[np.ndarray, float]:
        """Where the leader is, and its trigger."""
        leader = self._led_by(side)
        if leader.startswith("leader"):
            trigger = self._pull_leader(leader, side)
            self._compensate_gravity(leader)
            return self._q(leader), trigger
        if side not in self._paths:
            return self._setpoint[side], 1.0 - self._opening[side]
        begun, times, q, triggers = self._paths[side]
        t = self.now() - begun
        return np.array([np.interp(t, times, column) for column in q.T]), float(np.interp(t, times, triggers))

    def _pull_leader(self, leader: str, side: str) -> float:
        path, data = self._paths.get(side), self.world.data
        for i in range(6):
            actuator = data.actuator(f"{leader}/hand_{i + 1}")
            kp, kd = (HAND_KP, HAND_KD) if path else (0.0, 0.0)
            self._gains(f"{leader}/hand_{i + 1}", kp, kd)
            if path:
                begun, times, q, _ = path
                actuator.ctrl = kp * np.interp(self.now() - begun, times, q[:, i])
            else:
                actuator.ctrl = 0.0
            self.max_hand_nm = max(self.max_hand_nm, abs(float(actuator.force[0])))
        return float(np.interp(self.now() - path[0], path[1], path[3])) if path else 0.0

    def _compensate_gravity(self, channel: str) -> None:
        joints = [self.world.model.joint(f"{channel}/joint{i + 1}").dofadr[0] for i in range(6)]
        self.world.data.qfrc_applied[joints] = self.world.data.qfrc_bias[joints]
