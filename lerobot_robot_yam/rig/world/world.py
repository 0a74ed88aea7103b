"""Physics of the rig: the state of a scene's world, simulated in real time."""

import logging
import math
from pathlib import Path

import mujoco
import numpy as np

from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_profile import BaseProfile
from lerobot_robot_yam.rig.scene.scene import Scene
from lerobot_robot_yam.rig.world.world_model import build_world, world_dtype
from lerobot_robot_yam.system.shared_block import SharedBlock

logger = logging.getLogger(__name__)

_SLIP_S = 0.05  # lag behind real time above which simulated time is skipped (a slip), s
_SLIP_TELL_S = 5.0  # minimum interval between log messages about slips


class World:
    """Model, state and simulated time. `qpos`, `qvel` and `force` are lists, updated after each step.

    Attributes:
        ctrl: control inputs of the actuators, a view of `data.ctrl` with faster access to single numbers.
        sim_s: simulated time, s.
        stamp_s: monotonic time of the current state, s.
        slips: number of times that simulated time was skipped; `slipped_s`: length of the last skip, s.
        steps: number of completed steps.
        look_seed: seed of the images' look, see `Options.randomise_look`.
    """

    def __init__(self, scene: Scene):
        self.scene = scene
        self.model = build_world(scene, visible=False)
        self.data = mujoco.MjData(self.model)
        self.ctrl: memoryview[float] = memoryview(self.data.ctrl)
        self._state = self.data.qpos, self.data.qvel, self.data.actuator_force
        self.timestep_s = self.model.opt.timestep
        self.profiles = {row.channel: resolve_profiles(row.arm, row.gripper) for row in scene.arms}
        self.base = BaseProfile()
        self._addresses = {row.channel: self._look_up(row.channel) for row in scene.arms}
        for row in scene.arms:
            arm, gripper = self.profiles[row.channel]
            self.set_pose(row.channel, arm.rest_q(gripper) if row.q_rad is None else row.q_rad)
        if scene.base is not None and scene.base.rail is not None:
            self.data.joint(f"{scene.base.channel}/rail").qpos[0] = scene.base.rail.height_m
        mujoco.mj_forward(self.model, self.data)
        self.slips = self.steps = 0
        self.look_seed = scene.options.seed
        self.slipped_s = 0.0
        self._slip_told_s = -math.inf
        self._anchor_s = 0.0  # monotonic time at simulated time 0
        self._tell_time()
        self.refresh()

    def start(self, now_s: float) -> None:
        """Map the current simulated time to monotonic time `now_s`."""
        self._anchor_s = now_s - self.sim_s
        self._tell_time()

    def due(self, now_s: float) -> int:
        """Return the number of steps until `now_s`; skip time (a slip) if the simulation is too far behind."""
        behind = now_s - self.stamp_s
        if behind <= _SLIP_S:
            return max(0, int(behind / self.timestep_s))
        self._anchor_s += behind
        self._tell_time()
        self.slips += 1
        self.slipped_s = behind
        if now_s - self._slip_told_s > _SLIP_TELL_S:
            self._slip_told_s = now_s
            logger.warning(
                "physics fell %.0f ms behind (slip %d); simulated time is given up", behind * 1e3, self.slips
            )
        return 0

    def step(self, count: int) -> None:
        mujoco.mj_step(self.model, self.data, count)
        self.steps += count
        self._tell_time()
        self.refresh()

    def _tell_time(self) -> None:
        self.sim_s = self.steps * self.timestep_s
        self.stamp_s = self._anchor_s + self.sim_s

    def refresh(self) -> None:
        """Copy the state into lists, because the motors read single numbers, which is slow in numpy."""
        qpos, qvel, force = self._state
        self.qpos: list[float] = qpos.tolist()
        self.qvel: list[float] = qvel.tolist()
        self.force: list[float] = force.tolist()

    def _look_up(self, channel: str) -> list[tuple[list[int], list[int]]]:
        """Return the qpos and qvel addresses of the joints, then of the fingers; cached, because look-ups are slow."""
        arm, gripper = self.profiles[channel]
        names = [f"joint{i + 1}" for i in range(arm.joint_count)], gripper.finger_joints
        found = [[self.model.joint(f"{channel}/{name}") for name in row] for row in names]
        return [([int(j.qposadr[0]) for j in row], [int(j.dofadr[0]) for j in row]) for row in found]

    def joint_addresses(self, channel: str) -> list[int]:
        """Return the indices of an arm's joints in qpos."""
        return self._addresses[channel][0][0]

    def joint_dofs(self, channel: str) -> list[int]:
        """Return the indices of an arm's joints in qvel."""
        return self._addresses[channel][0][1]

    def bodies(self, of: str = "") -> dict[str, list[float]]:
        """Return the position (3,), m, of each body whose name begins with `of`."""
        names = [self.model.body(i).name for i in range(1, self.model.nbody)]
        return {name: self.data.body(name).xpos.tolist() for name in names if name.startswith(of)}

    def opening(self, channel: str) -> float | None:
        """Return the gripper's opening, 0 closed … 1 open; None for a gripper without fingers."""
        _, gripper = self.profiles[channel]
        if gripper.finger_range_m is None:
            return None
        low, high = gripper.finger_range_m
        fingers = self._addresses[channel][1][0]
        return float((sum(self.qpos[a] for a in fingers) / len(fingers) - low) / (high - low))

    def set_pose(
        self, channel: str, q_rad: np.ndarray | None = None, opening: float | None = None, dq: np.ndarray | float = 0.0
    ) -> None:
        """Teleport an arm to q_rad (n,), with speed dq (n,) rad/s, and its fingers to `opening`, at rest.

        Raises:
            ConfigError: n is wrong.
        """
        _, gripper = self.profiles[channel]
        (joints, dofs), (fingers, finger_dofs) = self._addresses[channel]
        if q_rad is not None:
            if len(q_rad) != len(joints):
                raise ConfigError(f"{channel} has {len(joints)} joints, the pose {len(q_rad)}")
            self.data.qpos[joints], self.data.qvel[dofs] = q_rad, dq
        if opening is not None and gripper.finger_range_m is not None:
            low, high = gripper.finger_range_m
            self.data.qpos[fingers], self.data.qvel[finger_dofs] = low + opening * (high - low), 0.0

    def base_pose(self) -> list[float] | None:
        """Return the base's true x, y, m, and heading, rad; None without a base."""
        if self.scene.base is None:
            return None
        x, y, _, w, i, j, k = self.data.joint(self.scene.base.channel).qpos.tolist()
        return [x, y, math.atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))]

    def put(self, prop: str, position_m: np.ndarray, quat_wxyz: np.ndarray) -> None:
        """Teleport a loose thing to a position (3,) and an orientation (4,), at rest."""
        joint = self.data.joint(prop)
        joint.qpos[:] = [*position_m, *(quat_wxyz / np.linalg.norm(quat_wxyz))]
        joint.qvel[:] = 0.0

    def set_joint(self, thing: str, position: float) -> None:
        """Teleport a jointed thing to a position of its joint, m or rad, at rest."""
        joint = self.data.joint(thing)
        joint.qpos[:], joint.qvel[:] = position, 0.0


class WorldBlock:
    """Shared memory block at `path` from which the renderer reads the state of a world."""

    def __init__(self, path: Path, world: World):
        self._record = np.zeros((), world_dtype(world.model))
        self._block = SharedBlock(path, self._record.dtype, create=True)

    def publish(self, world: World) -> None:
        """Write the current state of a world of the same scene."""
        record = self._record
        record["sim_s"], record["stamp_s"] = world.sim_s, world.stamp_s
        record["look_seed"] = world.look_seed
        record["qpos"], record["qvel"] = world.data.qpos, world.data.qvel
        self._block.write(record)

    def close(self) -> None:
        self._block.close()
