"""The newest pictures of a rig's cameras that somebody has opened, from the blocks of the rig's renderer."""

import contextlib
import re
import struct

import numpy as np

from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.rig.client.launch import rig_path
from lerobot_robot_yam.rig.client.rendered_camera import frame_dtype
from lerobot_robot_yam.system.runtime_files import slug
from lerobot_robot_yam.system.shared_block import SharedBlock

_SETTINGS = re.compile(r"(.+)-(\d+)x(\d+)-(\d+)")
_STAMP = struct.Struct("<d")  # the first field of a frame
_WIDEST = 320  # pixels; a frustum is small on the page


class RenderedPictures:
    """Those of one rig. It opens no camera: a camera that nobody uses has no picture."""

    def __init__(self, rig: str):
        self._rig = rig
        self._blocks: dict[str, SharedBlock] = {}
        self._shown: dict[SharedBlock, int] = {}

    def look(self) -> None:
        """See which cameras are open now."""
        head = rig_path(self._rig, "camera-")
        found = {path.name.removeprefix(head.name): path for path in head.parent.glob(f"{head.name}*")}
        for name in [name for name, block in self._blocks.items() if name not in found or not block.current]:
            self._forget(name)
        for name, path in found.items():
            settings = _SETTINGS.fullmatch(name)
            if settings is not None and name not in self._blocks:
                with contextlib.suppress(FileNotFoundError, StaleStateError):  # it is opened or closed just now
                    dtype = frame_dtype(int(settings[2]), int(settings[3]))
                    self._blocks[name] = SharedBlock(path, dtype, create=False)

    def open_ones(self, now_s: float) -> dict[str, float]:
        """Cameras as the names of their blocks have them, `top-320x240-30`, and how old their pictures are, s."""
        return {name: now_s - block.peek(0, _STAMP) for name, block in sorted(self._blocks.items())}

    def is_open(self, camera: str) -> bool:
        """Whether somebody has opened a camera."""
        return self._of(camera) is not None

    def newest(self, camera: str) -> np.ndarray | None:
        """(h, w, 3) uint8 RGB, at most 320 wide; None: there is no newer one than that of the last call."""
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
        """Let go of all. Idempotent."""
        for name in list(self._blocks):
            self._forget(name)
