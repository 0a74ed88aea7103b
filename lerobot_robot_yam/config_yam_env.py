"""LeRobot config of an environment with a YAM robot (`lerobot-eval --env.type=yam`)."""

import contextlib
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import gymnasium as gym
import lerobot.cameras.opencv
import lerobot.cameras.realsense  # noqa: F401  `lerobot-eval` itself registers no cameras
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import freeze_after_episode_end
from lerobot.robots.config import RobotConfig
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.registration import register_as

AGENT_POS = "agent_pos"


def eyes_of(robot: Any) -> dict[str, Any]:
    """Return the configs of a robot's colour cameras by name; policies in an environment get the images of these."""
    return {name: camera for name, camera in robot.all_cameras().items() if getattr(camera, "use_rgb", True)}


@register_as(EnvConfig, "yam")
@dataclass
class YamEnvConfig(EnvConfig):
    """A connected YAM robot as a gymnasium environment."""

    task: str | None = option(
        "on a virtual rig, a task of its scene; elsewhere what the operator sees", "lift_and_place"
    )
    robot: RobotConfig | None = option("the robot, as for lerobot-record (--env.robot.type=bi_yam_follower …)", None)
    time_limit_s: float | None = option(
        "length of an episode, s; by default as the task says, 30 where it does not", None
    )
    lockstep: bool = option(
        "simulate the virtual rig in lock-step: deterministic per seed, and as fast as the machine allows", False
    )
    scene: str | None = option(
        "of a virtual rig that is started for this environment; by default the scene called as the task", None
    )
    rig_options: dict[str, Any] = option("options of such a rig", factory=dict)
    success: str = option(
        "who judges: rig, operator (keys: s success, f failure), or a function module:name that takes an "
        "observation and returns true, false or none",
        "rig",
    )
    reset_pose: list[float] | None = option(
        "joints (rad) and grippers (0 … 1) from which episodes begin; by default the waiting poses of the task's scene",
        None,
    )
    render_camera: str | None = option(
        "camera of the videos, one of the robot's or of the scene; by default the first", None
    )
    description: str | None = option("the task in words, for policies that read; by default as the task says", None)

    def __post_init__(self) -> None:
        with contextlib.suppress(ConfigError):  # raised again by `create_envs`; here the parser would hide the reason
            self._describe()

    def _describe(self) -> None:
        """Set the features. Raises ConfigError: no robot is chosen."""
        if self.robot is None or not hasattr(self.robot, "action_keys"):
            raise ConfigError("env.robot: choose the robot, such as --env.robot.type=bi_yam_follower")
        action_keys, state_keys, cameras = self.robot.action_keys(), self.robot.state_keys(), eyes_of(self.robot)
        self.features = {
            ACTION: PolicyFeature(FeatureType.ACTION, (len(action_keys),)),
            AGENT_POS: PolicyFeature(FeatureType.STATE, (len(state_keys),)),
        }
        self.features_map = {ACTION: ACTION, AGENT_POS: OBS_STATE}
        for name, camera in cameras.items():
            key = f"{OBS_IMAGES}.{name}"
            self.features[key] = PolicyFeature(FeatureType.VISUAL, (camera.height, camera.width, 3))
            self.features_map[key] = key

    def check_reset_pose(self, motors: list[str]) -> None:
        """Check that `motors`, those of the robot in canonical order, can reach the reset pose."""
        if self.reset_pose is None:
            return
        limits: list[tuple[float, float]] = []
        for arm in cast(Any, self.robot).arms().values():
            hardware = ResolvedArm(arm)
            limits += zip(hardware.lower.tolist(), hardware.upper.tolist(), strict=True)
        if len(self.reset_pose) != len(limits):
            raise ConfigError(f"env.reset_pose: {len(self.reset_pose)} values, not {len(limits)}: {', '.join(motors)}")
        for motor, value, (low, high) in zip(motors, self.reset_pose, limits, strict=True):
            if not low <= value <= high:
                raise ConfigError(
                    f"env.reset_pose: {motor} is {value:g}, outside {low:.3f} … {high:.3f} (rad; grippers 0 … 1)"
                )

    @property
    def virtual(self) -> bool:
        """Whether the robot is part of a virtual rig."""
        return self.lockstep or all(arm.interface == "yam_sim" for arm in cast(Any, self.robot).arms().values())

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Empty mapping, since the environment is not created through gymnasium's registry."""
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """Create {"yam": {0: vector environment}}; the first reset of an environment connects its robot.

        Raises:
            ConfigError: no robot is chosen, its config is invalid, or several environments share one real robot.
        """
        from lerobot_robot_yam.yam_env import YamEnv

        self._describe()
        if n_envs > 1 and not self.virtual:
            raise ConfigError(f"{n_envs} environments, but one real robot: use --eval.batch_size=1")
        # Gymnasium would reset environments that end before the others; freezing them avoids the reset.
        makers = [freeze_after_episode_end(partial(YamEnv, self, index, n_envs)) for index in range(n_envs)]
        mode = gym.vector.AutoresetMode.NEXT_STEP
        if use_async_envs and n_envs > 1:
            vector: gym.vector.VectorEnv = gym.vector.AsyncVectorEnv(makers, context="forkserver", autoreset_mode=mode)
        else:
            vector = gym.vector.SyncVectorEnv(makers, autoreset_mode=mode)
        return {self.type: {0: vector}}
