"""The world of a virtual rig, as the block says that it shows to its renderer. The rig is asked nothing."""

import mujoco
import numpy as np

from lerobot_robot_yam.arm.model import base_quat
from lerobot_robot_yam.rig.client.launch import rig_path
from lerobot_robot_yam.rig.client.told_scene import told_scene
from lerobot_robot_yam.rig.world.world_model import build_world, world_dtype
from lerobot_robot_yam.system.shared_block import SharedBlock


class RigWorld:
    """One rig's.

    Args:
        name: of the rig, as in the names of its files.

    Attributes:
        scene: what it simulates.
        model, data: MuJoCo's, as read last: poses, cameras and contacts.

    Raises:
        RigError, FileNotFoundError: no such rig runs.
        ConfigError, StaleStateError: its scene's file has changed since it has started.
    """

    def __init__(self, name: str):
        self.name = name
        self.scene = told_scene(name)
        self.model = build_world(self.scene)
        self.data = mujoco.MjData(self.model)
        self._bases = {
            row.channel: (row.position_m, base_quat(row.yaw_rad, row.tilt_rad.tolist())) for row in self.scene.arms
        }
        self._stamp_s = -1.0
        self._block = SharedBlock(rig_path(name, "world"), world_dtype(self.model), create=False)

    @property
    def current(self) -> bool:
        """False once it has ended."""
        return self._block.current

    @property
    def floor_z_m(self) -> float:
        """Height of the floor that the table stands on."""
        return float(self.model.geom("floor").pos[2])

    def base(self, channel: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Position (3,) m and w x y z (4,) of the base of the arm on a channel; None: it has none there."""
        return self._bases.get(channel)

    def read(self) -> bool:
        """Take the newest state; False: there is no newer one."""
        record = self._block.glance()
        if record is None or float(record["stamp_s"]) == self._stamp_s:
            return False
        self._stamp_s = float(record["stamp_s"])
        self.data.qpos[:] = record["qpos"]
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight, mujoco.mj_collision):
            compute(self.model, self.data)
        return True

    def contacts(self) -> list[tuple[str, str, np.ndarray]]:
        """What touches an arm, which may be itself: names of both bodies, an arm's first, and the point (3,) m."""
        found = []
        for index in range(self.data.ncon):
            contact = self.data.contact[index]
            names = [self.model.body(int(self.model.geom_bodyid[geom])).name for geom in contact.geom]
            names.sort(key=lambda name: name.partition("/")[0] not in self._bases)
            if contact.dist < 0.0 and names[0].partition("/")[0] in self._bases:
                found.append((names[0], names[1], contact.pos.copy()))
        return found

    def close(self) -> None:
        """Let go of the block. Idempotent."""
        self._block.close(remove=False)
