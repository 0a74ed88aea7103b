"""The devices of the soak: the shipped LeRobot classes as in configs/sim/teleoperate.yaml, and what they last gave."""

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, FollowerArmConfig
from lerobot_robot_yam.config_yam_remote import BiYamRemoteConfig
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.faults import RESPONSES, Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, Limited, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from lerobot_robot_yam.yam_follower import BiYamFollower
from lerobot_robot_yam.yam_remote import BiYamRemote
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig
from lerobot_teleoperator_yam.config_yam_remote_leader import BiYamRemoteLeaderConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader
from lerobot_teleoperator_yam.yam_remote_leader import BiYamRemoteLeader
from soak.checks import GRIPPER
from soak.schedule import CAMERA, CHANNELS, FOLLOWERS, LEADERS

TORQUE_LIMIT_NM = [20.0, 24.0, 20.0, 7.0, 7.0, 7.0]  # below the motors' own, or the clip could not be seen
_HUNG_S = 0.3
_BILATERAL = 0.15  # usual in labs


def keys(rig: str) -> dict[str, str]:
    """Names of the arms' shared blocks, by channel."""
    return {channel: channel_key("yam_sim", channel, rig) for channel in CHANNELS}


class Device:
    """The robot or the teleoperator, with the arms' state blocks and the stamps of what was last returned.

    Args:
        device: of LeRobot.
        channels: its arms, in canonical order.
        rig: name of the rig.
    """

    def __init__(self, device: Any, channels: Sequence[str], rig: str):
        self.device, self.channels = device, tuple(channels)
        self.name = device.name
        self.stamps_s: list[float] = []  # of the arms' states that were last returned
        self.camera_stamp_s = float("inf")
        self._keys = keys(rig)
        group = device._arms  # what a caller is given carries no stamp: it is noted on the way
        observe = group.observe

        def noted() -> Any:
            states = observe()
            self.stamps_s = [state.stamp_s for state in states]
            return states

        group.observe = noted
        for camera in getattr(device, "cameras", {}).values():
            self._note_camera(camera._camera)

    def _note_camera(self, camera: Any) -> None:
        latest = camera.latest

        def noted(max_age_s: float) -> Any:
            frame, self.camera_stamp_s = latest(max_age_s)
            return frame, self.camera_stamp_s

        camera.latest = noted

    @property
    def max_state_age_s(self) -> float:
        """Age from which on a state is an error."""
        return float(next(iter(self.device.config.arms().values())).max_state_age_s)

    def jobs(self) -> dict[str, dict[str, Any]]:
        """What the monitor has to know of the arms, by channel."""
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
            }
        return found

    def record(self, channel: str) -> Any:
        """The newest state record of an arm, or None."""
        with contextlib.suppress(FileNotFoundError, YamError):
            block = SharedBlock(state_path(self._keys[channel]), STATE_DTYPE, create=False)
            try:
                return block.read()
            finally:
                block.close()
        return None

    def remedy(self) -> str:
        """What the policy says has to be done: "nothing", "wait", "re-arm" or "reconnect"."""
        remedy = "nothing"
        for channel in self.channels:
            record = self.record(channel)
            if record is None:
                return "reconnect"
            mode, text = Mode(int(record["mode"])), bytes(record["trouble"]).rstrip(b"\0").decode()
            if mode in (Mode.OFF, Mode.OFFLINE, Mode.LAND) or (text and not RESPONSES[Trouble(text)].in_place):
                return "reconnect"
            if text or mode is Mode.FAULT or Limited(int(record["limited"])) & Limited.PEER:
                remedy = "re-arm"
            elif remedy == "nothing" and time.monotonic() - float(record["stamp_s"]) > _HUNG_S:
                remedy = "wait"
        return remedy

    def observe(self) -> None:
        """Look at the arms.

        Raises:
            YamError: one is silent or has failed.
        """
        self.device._arms.observe()

    def rearm(self) -> None:
        """Re-arm in place; leaders float again.

        Raises:
            YamError: it does not work.
        """
        self.device.rearm()
        if self.channels == LEADERS:
            self.device.disable_torque()


def make_devices(rig: str, folder: Path, coupled: bool = False, host: str | None = None) -> tuple[Device, Device]:
    """Robot and teleoperator, with a camera and a torque clip; maybe with coupling, gate and force feedback.

    host: address of the yam-host that has the arms (`soak.host`); None: they are driven from here.
    """
    camera = YamSimCameraConfig(camera=CAMERA, rig=rig, width=160, height=120, fps=15)
    if host is not None:
        robot: Any = BiYamRemote(BiYamRemoteConfig(id="soak", host=host, cameras={CAMERA: camera}))
        leader: Any = BiYamRemoteLeader(BiYamRemoteLeaderConfig(id="soak", host=host))
        return Device(robot, FOLLOWERS, rig), Device(leader, LEADERS, rig)
    left, right = (FollowerArmConfig(**options) for options in follower_options(rig))
    robot = BiYamFollower(
        BiYamFollowerConfig(
            id="soak",
            calibration_dir=folder / "robot",
            left_arm_config=left,
            right_arm_config=right,
            cameras={CAMERA: camera},
        )
    )
    first, second = (LeaderArmConfig(**options) for options in leader_options(rig, coupled))
    leader = BiYamLeader(
        BiYamLeaderConfig(id="soak", calibration_dir=folder / "leader", left_arm_config=first, right_arm_config=second)
    )
    return Device(robot, FOLLOWERS, rig), Device(leader, LEADERS, rig)


def _common(rig: str) -> dict[str, Any]:
    return {
        "interface": "yam_sim",
        "gravity_factor": [1.0] * 6,
        "can_options": {"rig": rig},
        "torque_limit_nm": TORQUE_LIMIT_NM,
    }


def follower_options(rig: str) -> list[dict[str, Any]]:
    """Options of both followers, left and right."""
    return [{"channel": channel, "gripper": "linear_4310", **_common(rig)} for channel in FOLLOWERS]


def leader_options(rig: str, coupled: bool) -> list[dict[str, Any]]:
    """Options of both leaders, left and right."""
    found = []
    for channel, follower in zip(LEADERS, FOLLOWERS, strict=True):
        leads = {"follower": follower, "gate": "auto", "bilateral": _BILATERAL} if coupled else {}
        found.append({"channel": channel, **_common(rig), **leads})
    return found
