"""Drivers that the benchmark compares, each with the same five methods."""

import importlib
import time
from typing import Any, Protocol

import numpy as np
from recorders import sample_age_s

_CHANNELS = ("follower_left", "follower_right")
_SIDES = ("left", "right")
_SOCKETCAN = "can_"  # the vendor's SDK treats only channels with this in their names as socketcan
_STOPS_RAD = [3.25, -3.3]  # gripper stops in the default scene, so that no search is needed
_NAMES = ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6", "gripper")
_TYPES = ("DM4340", "DM4340", "DM4340", "DM4310", "DM4310", "DM4310", "DM4310")
_KP = (80.0, 80.0, 80.0, 10.0, 10.0, 10.0, 20.0)
_KD = (5.0, 5.0, 5.0, 1.5, 1.5, 1.5, 0.5)


class Driver(Protocol):
    """Interface of every driver under measurement."""

    def start(self) -> None:
        """Open the channels and energise the arms, which then hold."""

    def get(self) -> Any:
        """Read all arms, like a LeRobot robot for an observation."""

    def send(self, got: Any) -> None:
        """Command all arms to stay at the positions in `got`."""

    def age_s(self, got: Any, now: float) -> float:
        """Return the age of the oldest motor sample in `got` at `now`, from the rig's stamps in temperature bytes."""

    def stop(self) -> None:
        """Disconnect all arms."""


class OurSession:
    """Our control loop, accessed through `ArmSession`; with `base`, a mobile base ticks in the same loop."""

    def __init__(self, arms: int, isolation: str = "process", rate_hz: float = 250.0, base: bool = False):
        from lerobot_robot_yam.arm.config import ArmConfig
        from lerobot_robot_yam.mobile.base_config import BaseConfig
        from lerobot_robot_yam.session.arm_session import ArmSession

        self._names = _SIDES[:arms]
        configs = [
            ArmConfig(name=side, channel=channel, interface="yam_sim", rate_hz=rate_hz, gripper_stops_rad=_STOPS_RAD)
            for side, channel in zip(self._names, _CHANNELS, strict=False)
        ]
        self._base = [BaseConfig(channel="base", interface="yam_sim", rate_hz=rate_hz)] if base else []
        self._session = ArmSession([*configs, *self._base], isolation=isolation)  # type: ignore[arg-type]

    def start(self) -> None:
        self._session.start()

    def get(self) -> Any:
        for base in self._base:
            self._session.base(base.name).observe()
        return [self._session[name].observe() for name in self._names]

    def send(self, got: Any) -> None:
        for base in self._base:
            self._session.base(base.name).write_velocity([0.0, 0.0, 0.1])
        for name, state in zip(self._names, got, strict=True):
            self._session[name].write_target(state.setpoint_q, state.gripper_setpoint)

    def age_s(self, got: Any, now: float) -> float:
        return max(
            sample_age_s(int(mos), int(rotor), now)
            for state in got
            for mos, rotor in zip(state.temp_mos_c, state.temp_rotor_c, strict=True)
        )

    def stop(self) -> None:
        self._session.stop()


class OurRobot:
    """`BiYamFollower` without cameras, as used by `lerobot-record`."""

    def __init__(self, temperatures: bool = False):
        from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig
        from lerobot_robot_yam.yam_follower import BiYamFollower

        left, right = (
            FollowerArmConfig(channel=channel, interface="yam_sim", gripper_stops_rad=_STOPS_RAD)
            for channel in _CHANNELS
        )
        self._robot = BiYamFollower(
            BiYamFollowerConfig(left_arm_config=left, right_arm_config=right, observe_temperature=temperatures)
        )

    def start(self) -> None:
        self._robot.connect()
        observation = self._robot.get_observation()
        self._action = {key: observation[key] for key in self._robot.action_features}

    def get(self) -> Any:
        return self._robot.get_observation()

    def send(self, got: Any) -> None:
        self._robot.send_action(self._action)

    def age_s(self, got: Any, now: float) -> float:
        motors = [key.removesuffix(".pos") for key in self._action]
        return max(sample_age_s(int(got[f"{m}.temp_mos"]), int(got[f"{m}.temp_rotor"]), now) for m in motors)

    def stop(self) -> None:
        self._robot.disconnect()


class DamiaoBus:
    """LeRobot's own driver with the calls of LeRobot's OpenArm robot: refresh all motors, then command all."""

    def __init__(self, arms: int):
        from lerobot.motors import Motor, MotorNormMode
        from lerobot.motors.damiao import DamiaoMotorsBus

        self._buses = []
        for channel in _CHANNELS[:arms]:
            motors = {}
            for number, (name, kind) in enumerate(zip(_NAMES, _TYPES, strict=True), start=1):
                motor = Motor(number, kind.lower(), MotorNormMode.DEGREES)
                motor.recv_id, motor.motor_type_str = number + 16, kind
                motors[name] = motor
            self._buses.append(DamiaoMotorsBus(channel, motors, can_interface="yam_sim", use_can_fd=False))
        self._goals: list[dict[str, float]] = []

    def start(self) -> None:
        for bus in self._buses:
            bus.connect()
            bus.enable_torque()
            states = bus.sync_read_all_states()
            self._goals.append({name: state["position"] for name, state in states.items()})

    def get(self) -> Any:
        return [bus.sync_read_all_states() for bus in self._buses]

    def send(self, got: Any) -> None:
        for bus, goals in zip(self._buses, self._goals, strict=True):
            bus._mit_control_batch({name: (_KP[i], _KD[i], goals[name], 0.0, 0.0) for i, name in enumerate(_NAMES)})

    def age_s(self, got: Any, now: float) -> float:
        return max(
            sample_age_s(int(state["temp_mos"]), int(state["temp_rotor"]), now)
            for states in got
            for state in states.values()
        )

    def stop(self) -> None:
        for bus in self._buses:
            bus.disconnect()


class Vendor:
    """The vendor's SDK, `dreamscale-i2rt`, started as its users do: `get_yam_robot`, holding the current pose.

    Each arm has two threads in the caller's interpreter, without a fixed rate: one computes gravity and the gripper's
    force limit, the other talks to the motors. The SDK opens a socketcan channel, which is redirected to the rig.
    Nothing else in the SDK is changed.
    """

    def __init__(self, arms: int):
        _lead_socketcan_to_rig()
        self._open = importlib.import_module("i2rt.robots.get_robot").get_yam_robot
        self._arms = arms
        self._robots: list[Any] = []
        self._goals: list[Any] = []

    def start(self) -> None:
        for channel in _CHANNELS[: self._arms]:
            robot = self._open(
                _SOCKETCAN + channel, zero_gravity_mode=False, gripper_limits_override=np.array(_STOPS_RAD)
            )
            robot.temp_record_flag = True  # temperatures contain the rig's stamp
            self._robots.append(robot)
            self._goals.append(robot.get_joint_pos().copy())

    def get(self) -> Any:
        return [robot.get_observations() for robot in self._robots]

    def send(self, got: Any) -> None:
        for robot, goal in zip(self._robots, self._goals, strict=True):
            robot.command_joint_pos(goal.copy())  # the SDK clips its argument in place

    def age_s(self, got: Any, now: float) -> float:
        return max(
            sample_age_s(int(mos), int(rotor), now)
            for seen in got
            for mos, rotor in zip(seen["temp_mos"], seen["temp_rotor"], strict=True)
        )

    def stop(self) -> None:
        for robot in self._robots:
            robot.close()


class VendorChain:
    """The SDK's motor chain alone, which only exchanges frames: no gravity, no limits, no caller."""

    def __init__(self, arms: int):
        _lead_socketcan_to_rig()
        self._open = importlib.import_module("i2rt.motor_drivers.dm_driver").DMChainCanInterface
        self._arms = arms
        self._chains: list[Any] = []

    def start(self) -> None:
        motors = [(number, kind) for number, kind in enumerate(_TYPES, start=1)]
        for channel in _CHANNELS[: self._arms]:
            chain = self._open(motors, np.zeros(7), np.ones(7), channel=_SOCKETCAN + channel)
            self._chains.append(chain)
            goal = np.array([info.pos for info in chain.read_states()])
            chain.set_commands(np.zeros(7), pos=goal, vel=np.zeros(7), kp=_KP, kd=_KD, get_state=False)

    def get(self) -> Any:
        return [chain.read_states() for chain in self._chains]

    def send(self, got: Any) -> None:
        pass  # the chain repeats its last command

    def age_s(self, got: Any, now: float) -> float:
        return max(sample_age_s(int(info.temp_mos), int(info.temp_rotor), now) for infos in got for info in infos)

    def stop(self) -> None:
        for chain in self._chains:
            chain.running = False
        time.sleep(0.2)  # the chain's thread cannot be joined
        for chain in self._chains:
            chain.close()


def _lead_socketcan_to_rig() -> None:
    import can

    real_bus = can.interface.Bus

    def open_on_rig(channel: str, **_: Any) -> can.BusABC:
        return real_bus(interface="yam_sim", channel=channel.removeprefix(_SOCKETCAN))

    can.interface.Bus = open_on_rig


KINDS = {
    "ours": OurSession,
    "ours_robot": OurRobot,
    "damiao_bus": DamiaoBus,
    "vendor": Vendor,
    "vendor_chain": VendorChain,
}
