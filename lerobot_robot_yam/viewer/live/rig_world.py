"""World and camera pictures of a virtual rig, read from the shared memory of its renderer without a connection."""

import contextlib
import re
import struct

import mujoco
import numpy as np

from lerobot_robot_yam.arm.model import base_quat
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.rig.client.launch import rig_path, told_scene
from lerobot_robot_yam.rig.client.rendered_camera import frame_dtype
from lerobot_robot_yam.rig.world.world_model import build_world, world_dtype
from lerobot_robot_yam.system.runtime_files import slug
from lerobot_robot_yam.system.shared_block import SharedBlock
from lerobot_robot_yam.viewer.figure import Place, on

_SETTINGS = re.compile(r"(.+)-(\d+)x(\d+)-(\d+)")
_STAMP = struct.Struct("<d")  # first field of a frame: timestamp, s
_WIDEST = 320  # maximum picture width, pixels: a frustum is small on the page


class RigWorld:
    """World of one rig.

    `name`: name of the rig as in its file names.

    Attributes:
        scene: the simulated scene.
        model, data: MuJoCo's model and data, with the poses, cameras and contacts as of the last `read`.

    Raises:
        RigError, FileNotFoundError: no rig with this name runs.
        ConfigError, StaleStateError: the scene's file has changed since the rig started.
    """

    def __init__(self, name: str):
        self.name = name
        self.scene = told_scene(name)
        self.model = build_world(self.scene)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        base = self.scene.base
        self._bases = {  # channel → body on which the arm stands, place in its frame
            row.channel: (
                "world" if base is None or not row.on_base else f"{base.channel}/mount",
                (row.position_m, base_quat(row.yaw_rad, row.tilt_rad.tolist())),
            )
            for row in self.scene.arms
        }
        self._stamp_s = -1.0
        self._block = SharedBlock(rig_path(name, "world"), world_dtype(self.model), create=False)

    @property
    def current(self) -> bool:
        """Whether the rig is still running."""
        return self._block.current

    @property
    def floor_z_m(self) -> float:
        """Height of the floor below the table, m."""
        return float(self.model.geom("floor").pos[2])

    def base(self, channel: str) -> Place | None:
        """Return the place of the base of a channel's arm, as of the last `read`; None without an arm."""
        if channel not in self._bases:
            return None
        carrier, place = self._bases[channel]
        return on(self.body(carrier), place)

    def body(self, name: str) -> Place:
        """Return the place of a body, as of the last `read`."""
        body = self.data.body(name)
        return body.xpos.copy(), body.xquat.copy()

    def read(self) -> bool:
        """Read the newest state. Return False if there is none since the last read."""
        record = self._block.glance()
        if record is None or float(record["stamp_s"]) == self._stamp_s:
            return False
        self._stamp_s = float(record["stamp_s"])
        self.data.qpos[:] = record["qpos"]
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight, mujoco.mj_collision):
            compute(self.model, self.data)
        return True

    def contacts(self) -> list[tuple[str, str, np.ndarray]]:
        """Return the contacts of arms: (arm's body, other body, contact point (3,), m)."""
        found = []
        for index in range(self.data.ncon):
            contact = self.data.contact[index]
            names = [self.model.body(int(self.model.geom_bodyid[geom])).name for geom in contact.geom]
            names.sort(key=lambda name: name.partition("/")[0] not in self._bases)
            if contact.dist < 0.0 and names[0].partition("/")[0] in self._bases:
                found.append((names[0], names[1], contact.pos.copy()))
        return found

    def close(self) -> None:
        """Release the shared memory. Idempotent."""
        self._block.close(remove=False)


class RenderedPictures:
    """Pictures from one rig's cameras. This class opens no camera, so a camera without another user has no picture."""

    def __init__(self, rig: str):
        self._rig = rig
        self._blocks: dict[str, SharedBlock] = {}
        self._shown: dict[SharedBlock, int] = {}

    def look(self) -> None:
        """Update the list of open cameras."""
        head = rig_path(self._rig, "camera-")
        found = {path.name.removeprefix(head.name): path for path in head.parent.glob(f"{head.name}*")}
        for name in [name for name, block in self._blocks.items() if name not in found or not block.current]:
            self._forget(name)
        for name, path in found.items():
            settings = _SETTINGS.fullmatch(name)
            if settings is not None and name not in self._blocks:
                with contextlib.suppress(FileNotFoundError, StaleStateError):  # the camera is opening or closing
                    dtype = frame_dtype(int(settings[2]), int(settings[3]))
                    self._blocks[name] = SharedBlock(path, dtype, create=False)

    def open_ones(self, now_s: float) -> dict[str, float]:
        """Return block name of each open camera, such as `top-320x240-30` → age of its newest picture, s."""
        return {name: now_s - block.peek(0, _STAMP) for name, block in sorted(self._blocks.items())}

    def is_open(self, camera: str) -> bool:
        """Return whether a camera is open."""
        return self._of(camera) is not None

    def newest(self, camera: str) -> np.ndarray | None:
        """Return the newest picture, (h, w, 3) uint8 RGB, at most 320 wide; None if there is no new picture."""
        block = self._of(camera)
        if block is None or block.sequence() == self._shown.get(block):
            return None
        sequence, record = block.sequence(), block.glance()
        if record is None:
            return None
        self._shown[block] = sequence
        picture = record["rgb"]
        step = -(-picture.shape[1] // _WIDEST)
        return np.ascontiguousarray(picture[::step, ::step])

    def _of(self, camera: str) -> SharedBlock | None:
        head = f"{slug(camera)}-"
        rest = {name.removeprefix(head): block for name, block in self._blocks.items() if name.startswith(head)}
        return next((block for name, block in rest.items() if re.fullmatch(r"\d+x\d+-\d+", name)), None)

    def _forget(self, name: str) -> None:
        block = self._blocks.pop(name)
        self._shown.pop(block, None)
        block.close(remove=False)

    def close(self) -> None:
        """Release the shared memory of all cameras. Idempotent."""
        for name in list(self._blocks):
            self._forget(name)
