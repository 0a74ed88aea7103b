"""Gymnasium environment with a real or virtual YAM robot, paced at fps or in lock-step with a virtual rig."""

import contextlib
import copy
import logging
import math
import os
from collections.abc import Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np
from lerobot.robots.utils import make_robot_from_config

from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.config_yam_env import AGENT_POS, YamEnvConfig, eyes_of
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError, MotorError
from lerobot_robot_yam.face.devices.feature_names import motors_of
from lerobot_robot_yam.face.referee import CallableReferee, OperatorReferee, Referee, RigReferee, find_judge
from lerobot_robot_yam.rig.client.rendered_camera import RigCamera
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.rig.lockstep.lockstep_cameras import LockstepCamera
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.operator.script import make_setup
from lerobot_robot_yam.rig.scene.scene import SCENES, load_scene
from lerobot_robot_yam.rig.scene.tasks import Task
from lerobot_robot_yam.yam_follower import FollowerBase

logger = logging.getLogger(__name__)

_DEFAULT_TIME_LIMIT_S = 30.0
_ARRIVED = 0.05  # distance below which the reset pose counts as reached, rad or strokes
_REACH_TIMEOUT_S = 30.0
_GRIP_S = 2.0  # timeout for the grippers once the joints are at the reset pose, s: a gripper may hold an object
_SPECTATOR_SIZE = 320, 240  # width and height of the spectator's image, pixels
_SETTLE_S = 0.5  # rest at the reset pose before an episode begins, s


class YamEnv(gym.Env):
    """Environment with one robot; the first `reset` connects the robot, `close` lands it.

    Observations: {"agent_pos": (n,) float32, "pixels": {camera: (height, width, 3) uint8}}. Actions (m,): the robot's
    action vector, in canonical order and with the robot's units.

    Args:
        config: options of the environment.
        index: number of this environment in a vector; each virtual environment has its own rig.
        count: number of environments in the vector.

    Raises:
        ConfigError: the scene lacks the task, the render camera does not exist, or the reset pose is invalid.
    """

    def __init__(self, config: YamEnvConfig, index: int = 0, count: int = 1):
        self._config = config
        self._robot_config = cast(Any, copy.deepcopy(config.robot))
        self._virtual = config.virtual
        self._rig_name = f"env-{os.getpid()}-{index}" if count > 1 else None
        self._scene = config.scene or (config.task if config.task in SCENES else None)
        self._task = self._task_row()
        self.task = config.task
        self.task_description = config.description or (self._task.description if self._task else config.task or "")
        limit_s = config.time_limit_s or (self._task.time_limit_s if self._task else _DEFAULT_TIME_LIMIT_S)
        self._max_episode_steps = round(limit_s * config.fps)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": config.fps}
        self.render_mode = "rgb_array"
        self._action_keys = self._robot_config.action_keys()
        self._state_keys = self._robot_config.state_keys()
        self._cameras = {name: (camera.height, camera.width, 3) for name, camera in eyes_of(self._robot_config).items()}
        box, pictures = gym.spaces.Box, self._cameras.items()
        pixels = gym.spaces.Dict({name: box(0, 255, shape, np.uint8) for name, shape in pictures})
        state = box(-np.inf, np.inf, (len(self._state_keys),), np.float32)
        self.observation_space = gym.spaces.Dict({AGENT_POS: state, "pixels": pixels})
        self.action_space = box(-np.inf, np.inf, (len(self._action_keys),), np.float32)
        self._motors = motors_of(self._robot_config.arms())
        self._is_joint = np.array([not motor.endswith("gripper") for motor in self._motors])
        config.check_reset_pose(self._motors)
        name, there = config.render_camera, list(dict.fromkeys([*self._cameras, *self._scene_cameras()]))
        if name is not None and name not in there:
            raise ConfigError(f"env.render_camera: there is no camera '{name}'; there are {', '.join(there) or 'none'}")
        self._start_pose: np.ndarray | None = None
        self.sent = np.zeros(len(self._action_keys))  # last action that the robot actually sent
        self._rig: RigControl | LockstepRig | None = None
        self._robot: FollowerBase | None = None
        self._referee: Referee | None = None
        self._frame: np.ndarray | None = None
        self._observation: dict[str, Any] | None = None  # newest observation
        self._spectator: RigCamera | LockstepCamera | None = None
        self._deadline_s = 0.0
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Move to the reset pose, let the referee set up the scene, and observe.

        Raises:
            YamError: the robot or the rig fails, or the robot does not reach the pose.
        """
        super().reset(seed=seed)
        if self._config.lockstep:  # restart the world, so that episodes do not depend on earlier ones
            if self._robot is not None:
                self._robot.discard()
            if isinstance(self._rig, LockstepRig):
                self._rig.restart()
        robot, referee = self._connected()
        self._go_to_start(robot)
        referee.arrange(seed)
        robot.clock.sleep(_SETTLE_S)
        self._steps = 0
        self._deadline_s = robot.clock.now()
        return self._look(robot)[0], {"is_success": False}

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Send one action, wait for 1 / fps, observe and judge; the reward is 1 for success.

        If a part of the robot stops with a fault in lock-step, its actions have caused this, as by driving a base into
        a table: the episode ends without success, and the next `reset` restarts the world.

        Raises:
            YamError: the action is not finite or has a wrong length (nothing moves), or a robot out of lock-step fails.
        """
        try:
            return self._step(action)
        except MotorError as error:
            if not self._config.lockstep or self._observation is None:
                raise
            logger.warning("the episode has failed: %s", error)
            return self._observation, 0.0, True, False, {"is_success": False}

    def _step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        robot, referee = self._connected()
        sent = robot.send_action(self._named(action))
        self.sent = np.array([sent[key] for key in self._action_keys])
        period_s = 1.0 / self._config.fps
        self._deadline_s += period_s
        late_s = robot.clock.now() - self._deadline_s
        if late_s > period_s:
            logger.warning("an action was %.0f ms late; is the policy slower than %d fps?", late_s * 1e3, 1 / period_s)
            self._deadline_s = robot.clock.now()
        else:
            robot.clock.sleep(max(0.0, -late_s))
        observation, seen = self._look(robot)
        verdict = referee.verdict(seen)
        self._steps += 1
        cut = self._steps >= self._max_episode_steps and not verdict.over
        return observation, float(verdict.success), verdict.over, cut, {"is_success": verdict.success}

    def render(self) -> np.ndarray:
        """Return the newest image (height, width, 3) uint8 of the render camera, on the robot or in the virtual rig.

        Without a camera the image is black, since `lerobot-eval` always requests an image, even if it makes no video.
        """
        if self._frame is not None:
            return self._frame
        if self._rig is None:
            return np.zeros((*reversed(_SPECTATOR_SIZE), 3), np.uint8)
        if self._spectator is None:
            rig, name = self._rig, self._config.render_camera or self._scene_cameras()[0]
            view = name, *_SPECTATOR_SIZE, self._config.fps
            camera = LockstepCamera(rig, *view) if isinstance(rig, LockstepRig) else RigCamera(*view, rig.name)
            camera.connect()
            self._spectator = camera
        return self._spectator.latest()[0]

    def _scene_cameras(self) -> list[str]:
        """Return the names of the virtual rig's own cameras."""
        if not self._virtual:
            return []
        return [camera.name for camera in load_scene(self._scene, self._rig_options()).cameras]

    def _rig_options(self) -> dict[str, Any]:
        """Return the options for starting the virtual rig; in lock-step the rig has only the robot's arms."""
        arms = [arm.channel for arm in self._robot_config.arms().values()]
        return {**({"arms": arms} if self._config.lockstep else {}), **self._config.rig_options}

    def _task_row(self) -> Task | None:
        """Return the task in the virtual rig's scene; None without a rig. Raises ConfigError: there is no such task."""
        if not self._virtual or self._config.task is None:
            return None
        task = self._config.task
        tasks = {task.name: task for task in load_scene(self._scene, self._config.rig_options).tasks}
        if task not in tasks and self._config.success == "rig":
            raise ConfigError(f"env.task: the scene has no task '{task}'; it has {', '.join(tasks) or 'none'}")
        return tasks.get(task)

    @property
    def sides(self) -> list[str]:
        """Side of each arm, in canonical order, from the channel names: `follower_left` → `left`."""
        return [arm.channel.removeprefix("follower_") for arm in self._robot_config.arms().values()]

    def lockstep_task(self) -> tuple[LockstepRig, str]:
        """Return the lock-step rig and the name of its task, for scripted operators. Call `reset` first.

        Raises:
            ConfigError: the environment has no lock-step rig or no task.
        """
        if not isinstance(self._rig, LockstepRig) or self._task is None:
            raise ConfigError("a scripted operator needs an environment in lock-step, with a task of its scene")
        return self._rig, self._task.name

    def action_of(self, joints: np.ndarray, velocity: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)) -> np.ndarray:
        """Convert joints (rad) and grippers (0 … 1), (n,) in canonical order, to an action.

        velocity: of the base, (3,), m/s, m/s, rad/s, in its frame; unused without a base. A rail stays.
        """
        robot, _ = self._connected()
        x, y, theta = velocity
        base = {"x.vel": x, "y.vel": y, "theta.vel": math.degrees(theta), "height.vel": 0.0}
        named = base | robot.action_for(joints)
        return np.array([named[key] for key in self._action_keys], np.float32)

    def close(self) -> None:
        """Land the arms (a lock-step world ends without landing) and release all resources. Idempotent."""
        robot, parts = self._robot, (self._rig, self._referee, self._spectator)
        self._robot = self._rig = self._referee = self._spectator = None
        with contextlib.ExitStack() as rest:  # runs in reverse order: the arms land first
            for part in parts:
                if part is not None:
                    rest.callback(part.close)
            if robot is not None:
                rest.callback(robot.discard if self._config.lockstep else robot.disconnect)

    def _connected(self) -> tuple[FollowerBase, Referee]:
        """Return robot and referee; when first called, create the rig and the referee, then connect the robot."""
        if self._referee is None:
            self._referee = self._make_referee()
        if self._robot is None:
            robot = make_robot_from_config(self._robot_config)
            assert isinstance(robot, FollowerBase)
            self._robot, self._start_pose = robot, self._reset_pose()
        if not self._robot.is_connected:
            self._robot.connect()
        return self._robot, self._referee

    def _make_referee(self) -> Referee:
        config = self._config
        referee: Referee | None = None
        if self._virtual:
            self._rig = self._make_rig()
            if self._task is not None:
                referee = RigReferee(self._rig, self._task.name)
        if config.success == "operator":
            return OperatorReferee(config.task or "", referee)
        if config.success != "rig":
            judge = find_judge(config.success)
            return CallableReferee(referee or self._person(), judge)
        if referee is None:
            raise ConfigError(
                "env.success=rig needs a virtual rig and a task; on real arms choose operator or module:function"
            )
        return referee

    def _person(self) -> Referee:
        """Return a referee who sets up the scene: with real arms a person at the keyboard, if there is one."""
        if not self._virtual:
            try:
                return OperatorReferee(self._config.task or "")
            except ConfigError:
                logger.warning("no keyboard: episodes follow each other without asking; keep out of the arms' reach")
        return Referee()

    def _make_rig(self) -> RigControl | LockstepRig:
        arms = self._robot_config.arms()
        if self._config.lockstep:
            rig_in_step = LockstepRig(self._scene, **self._rig_options())
            self._join(rig_in_step)
            return rig_in_step
        if self._rig_name is not None:
            for part in self._parts():
                part.can_options = {**part.can_options, "rig": self._rig_name}
            for camera in self._robot_config.all_cameras().values():
                if camera.type == "yam_sim":
                    camera.rig = self._rig_name
        return RigControl(next(iter(arms.values())).can_options.get("rig"), self._scene, **self._rig_options())

    def _parts(self) -> list[Any]:
        """Return the configs of the robot's arms, and of its base if it has one."""
        base = getattr(self._robot_config, "base_config", None)
        return [*self._robot_config.arms().values(), *([] if base is None else [base])]

    def _join(self, rig: LockstepRig) -> None:
        """Connect the robot's channels and cameras to the rig."""
        rows = {row.channel: row for row in rig.device.scene.arms}
        self._robot_config.isolation = "lockstep"
        for part in self._parts():
            if part.channel not in rig.device.channels:
                raise ConfigError(f"{part.channel}: the scene has {', '.join(rig.device.channels)}")
            part.interface, part.can_options = "yam_lockstep", {"rig": rig.name}
        for arm in self._robot_config.arms().values():
            row = rows[arm.channel]
            calibration = load_gripper(row.gripper).calibration
            if arm.gripper_stops_rad is None and calibration is not None:
                stops = calibration.nominal_stops_rad if row.stops_rad is None else row.stops_rad
                arm.gripper_stops_rad = [float(stop) for stop in stops]  # stored stops would make runs differ
        for name, camera in self._robot_config.all_cameras().items():
            if camera.type != "yam_sim":
                raise ConfigError(f"camera {name}: type {camera.type}; in lock-step only yam_sim keeps the rig's time")
            camera.rig = rig.name

    def _go_to_start(self, robot: FollowerBase) -> None:
        """Move to the reset pose, at the speed limits of the control loop."""
        if self._start_pose is None:
            return
        deadline_s = robot.clock.now() + _REACH_TIMEOUT_S
        there_s = math.inf
        while True:
            robot.send_joints(self._start_pose)
            robot.clock.sleep(1.0 / self._config.fps)
            now, off = robot.clock.now(), np.abs(robot.joints() - self._start_pose)
            there_s = min(there_s, now) if off[self._is_joint].max(initial=0.0) < _ARRIVED else math.inf
            if off.max() < _ARRIVED or now - there_s > _GRIP_S:
                return
            if now > deadline_s:
                raise LifeCycleError(
                    f"{self._motors[int(off.argmax())]} is not at the reset pose after {_REACH_TIMEOUT_S:.0f} s; "
                    "is something in its way, or the emergency stop latched (yam-estop)?"
                )

    def _reset_pose(self) -> np.ndarray | None:
        """Return the joints and grippers at which episodes begin; None if they begin anywhere."""
        if self._config.reset_pose is not None:
            return np.array(self._config.reset_pose, float)
        if self._task is None or self._rig is None:
            return None
        setup = make_setup(self._rig.scene(), self._task.name)
        pose = np.ones(len(self._motors))  # opens the grippers
        pose[self._is_joint] = np.concatenate([setup.home_rad(side) for side in self.sides])
        return pose

    def _named(self, action: np.ndarray) -> dict[str, float]:
        values, keys = np.asarray(action, float).reshape(-1), self._action_keys
        if len(values) != len(keys):
            raise ActionError(f"an action has {len(values)} values, the robot takes {len(keys)}: {', '.join(keys)}")
        return dict(zip(keys, values.tolist(), strict=True))

    def _look(self, robot: FollowerBase) -> tuple[dict[str, Any], dict[str, Any]]:
        """Observe; return the observation for a policy, and the robot's complete observation."""
        seen = robot.get_observation()
        pixels = {name: seen[name] for name in self._cameras}
        self._frame = pixels.get(self._config.render_camera or next(iter(pixels), ""))
        state = np.array([seen[key] for key in self._state_keys], np.float32)
        self._observation = {AGENT_POS: state, "pixels": pixels}
        return self._observation, seen
