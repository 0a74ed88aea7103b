"""Devices of the soak: the shipped LeRobot classes, configured as in configs/sim/teleoperate.yaml."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig
from lerobot_robot_yam.state.faults import RESPONSES
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited, channel_key
from lerobot_robot_yam.yam_follower import BiYamFollower
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader
from soak.arm import newest_record
from soak.checks import GRIPPER, mode_of, trouble_of
from soak.injected_faults import CHANNELS, FOLLOWERS, LEADERS

_TORQUE_LIMIT_NM = [20.0, 24.0, 20.0, 7.0, 7.0, 7.0]  # per joint; below the motors' limits, so that the clip acts
_HUNG_S = 0.3  # state age from which the arm's control process counts as hung, s
_BILATERAL = 0.15  # gain of the force feedback; common in labs


def keys(rig: str) -> dict[str, str]:
    """Return the names of the arms' shared blocks, by channel."""
    return {channel: channel_key("yam_sim", channel, rig) for channel in CHANNELS}


class Device:
    """Robot or teleoperator, with the arms' state blocks and the stamps of the states returned last.

    Args:
        device: LeRobot device.
        channels: channels of the device's arms, in canonical order.
        rig: name of the rig.
    """

    def __init__(self, device: Any, channels: Sequence[str], rig: str):
        self.device, self.channels = device, tuple(channels)
        self.name = device.name
        self.stamps_s: list[float] = []  # stamps of the arms' states returned last
        self._keys = keys(rig)
        group = device._arms  # returned observations have no stamp, so `observe` is wrapped to note the stamps
        observe = group.observe

        def noted() -> Any:
            states = observe()
            self.stamps_s = [state.stamp_s for state in states]
            return states

        group.observe = noted

    @property
    def max_state_age_s(self) -> float:
        """Age from which a state counts as stale and raises an error."""
        return float(next(iter(self.device.config.arms().values())).max_state_age_s)

    def jobs(self) -> dict[str, dict[str, Any]]:
        """Return what the monitor needs to know about the arms, by channel."""
        found = {}
        arms = self.device.config.arms()
        for channel, config in zip(self.channels, arms.values(), strict=True):
            hardware = ResolvedArm(config)
            speed = np.full(GRIPPER + 1, np.nan)
            speed[hardware.slots] = hardware.speed_limit
            motor_speed = hardware.speed_limit.copy()
            calibration = hardware.gripper.calibration
            if hardware.has_gripper and calibration is not None:
                motor_speed[-1] *= abs(float(np.subtract(*calibration.nominal_stops_rad)))
            found[channel] = {
                "key": self._keys[channel],
                "role": "follower" if channel in FOLLOWERS else "leader",
                "peer": next(other for other in self.channels if other != channel),
                "speed_limit": speed.tolist(),
                "motor_speed_limit": motor_speed.tolist(),
                "torque_limit": hardware.torque_limit_nm.tolist(),
                "kp": hardware.kp.tolist(),
                "kd": hardware.kd.tolist(),
                "rest_q": hardware.rest_q.tolist(),
                "leads": getattr(config, "follower", None),
                "tick_s": 1.0 / config.rate_hz,
            }
        return found

    def remedy(self) -> str:
        """Return the recovery that the policy requires: "nothing", "wait", "re-arm" or "reconnect"."""
        remedy = "nothing"
        for channel in self.channels:
            record = newest_record(self._keys[channel])
            if record is None:
                return "reconnect"
            mode, trouble = mode_of(record), trouble_of(record)
            if mode in (Mode.OFF, Mode.OFFLINE, Mode.LAND) or (trouble and not RESPONSES[trouble].in_place):
                return "reconnect"
            if trouble or mode is Mode.FAULT or Limited(int(record["limited"])) & Limited.PEER:
                remedy = "re-arm"
            elif remedy == "nothing" and time.monotonic() - float(record["stamp_s"]) > _HUNG_S:
                remedy = "wait"
        return remedy

    def observe(self) -> None:
        """Read the states of the arms.

        Raises:
            YamError: an arm is silent or has failed.
        """
        self.device._arms.observe()

    def rearm(self) -> None:
        """Re-arm in place; leaders then float again.

        Raises:
            YamError: re-arming failed.
        """
        self.device.rearm()
        if self.channels == LEADERS:
            self.device.disable_torque()


def make_devices(rig: str, folder: Path, rate_hz: float, coupled: bool = False) -> tuple[Device, Device]:
    """Create robot and teleoperator with a torque clip; `coupled` adds coupling, gate and force feedback."""
    common: dict[str, Any] = {
        "rate_hz": rate_hz,
        "interface": "yam_sim",
        "gravity_factor": [1.0] * 6,
        "can_options": {"rig": rig},
        "torque_limit_nm": _TORQUE_LIMIT_NM,
    }
    left, right = (FollowerArmConfig(channel=name, gripper="linear_4310", **common) for name in FOLLOWERS)
    robot = BiYamFollower(
        BiYamFollowerConfig(id="soak", calibration_dir=folder / "robot", left_arm_config=left, right_arm_config=right)
    )
    leads: dict[str, Any] = {"gate": "auto", "bilateral": _BILATERAL} if coupled else {}
    first, second = (
        LeaderArmConfig(channel=name, **common, **leads, **({"follower": follower} if coupled else {}))
        for name, follower in zip(LEADERS, FOLLOWERS, strict=True)
    )
    leader = BiYamLeader(
        BiYamLeaderConfig(id="soak", calibration_dir=folder / "leader", left_arm_config=first, right_arm_config=second)
    )
    return Device(robot, FOLLOWERS, rig), Device(leader, LEADERS, rig)
