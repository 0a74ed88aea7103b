"""The open cameras of a rig: when each is due, which state it shows, how it is painted, and where its frames go.

Software OpenGL paints, cheap enough for three cameras beside a control loop. Only a process that set MUJOCO_GL before
importing mujoco may use this, as `renderer` does.
"""

import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.client.launch import rig_path
from lerobot_robot_yam.rig.client.rendered_camera import Settings, frame_dtype, frame_path
from lerobot_robot_yam.rig.render.look import Look
from lerobot_robot_yam.rig.render.shade import Shade
from lerobot_robot_yam.rig.render.sight import Sight
from lerobot_robot_yam.rig.scene.scene import Scene
from lerobot_robot_yam.rig.world.world_model import build_world, world_dtype
from lerobot_robot_yam.system.shared_block import SharedBlock

_UNCHANGED = 1e-6  # rad or m; below this in every joint the last picture is still right
_ALL_SEEING = ("overview",)  # cameras that show the leaders too
_MARGIN = 64  # a larger sheet of noise than the picture, cut elsewhere for each exposure
# Measured here: 12 slices, 2 stacks, no shadow maps and no multisampling cost a quarter of MuJoCo's defaults.
_SLICES, _STACKS = 12, 2
_BALL_STACKS = 6  # where something is not a box, rod or plane: two stacks of a ball are an octahedron
_SPHERE, _ELLIPSOID = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID
_SMALLEST = (320, 240)
_MAX_GEOMS = 400
_VISUAL_GROUPS = (0, 2)  # collision shapes are in 3, sites in 4
_HIDDEN_GROUP, _UNSEEN_GROUP = 5, 4


class Painter:
    """Renders cameras of one model into RGB arrays. One thread, one OpenGL context, one offscreen buffer.

    Args:
        model: the world; its visual quality settings are overwritten.
        hidden: prefixes of bodies that are left out, with all they carry (leaders, which no camera is for).

    Raises:
        RigError: no OpenGL context can be made.
    """

    def __init__(self, model: mujoco.MjModel, hidden: Sequence[str] = ()):
        self.model = model
        self.data = mujoco.MjData(model)
        quality = model.vis.quality
        balls = bool(np.isin(model.geom_type, (_SPHERE, _ELLIPSOID)).any())
        quality.numslices, quality.numstacks = _SLICES, _BALL_STACKS if balls else _STACKS
        quality.offsamples = quality.shadowsize = 0
        width, height = _SMALLEST
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        _regroup(model, hidden)
        self._groups = model.geom_group.copy()
        self._sights: dict[tuple[int, float], Sight] = {}
        try:
            self._gl = mujoco.GLContext(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # each OpenGL backend raises other errors, some of them plain Exception
            raise RigError(
                f"rendered cameras need OpenGL through EGL, which failed ({error}); install a software one "
                "(Debian and Ubuntu: libegl1 libgl1-mesa-dri) or run without rendered cameras"
            ) from error
        self._shade = Shade(model, self._context)
        self._shaded: bool | None = None  # with hidden bodies or not; None: not in this state
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, _MAX_GEOMS)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = 0
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [int(group in _VISUAL_GROUPS) for group in range(mujoco.mjNGROUP)]
        self._option.sitegroup[:] = 0
        self._raw: dict[tuple[int, int], np.ndarray] = {}

    def pose(self, qpos: np.ndarray) -> None:
        """Take a state, (nq,)."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        self._shaded = None

    def paint(self, camera: str, out: np.ndarray, show_hidden: bool = False) -> None:
        """Render one camera of the model into out, (height, width, 3) uint8 RGB, first row on top."""
        height, width, _ = out.shape
        context = self._context
        if width > context.offWidth or height > context.offHeight:  # no larger than needed: clearing it costs time
            mujoco.mjr_resizeOffscreen(max(width, context.offWidth), max(height, context.offHeight), context)
        if self._shaded is not show_hidden:
            groups = (*_VISUAL_GROUPS, _HIDDEN_GROUP) if show_hidden else _VISUAL_GROUPS
            self._shade.draw(self.data, groups)
            self._shaded = show_hidden
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self.model.camera(camera).id
        raw = self._raw.setdefault((height, width), np.empty((height, width, 3), np.uint8))
        self._option.geomgroup[_HIDDEN_GROUP] = int(show_hidden)
        key = (view.fixedcamid, width / height)
        if key not in self._sights:
            self._sights[key] = Sight(self.model, *key)
        seen, sky = self._sights[key].seen(self.data)
        self.model.geom_group[~seen] = _UNSEEN_GROUP
        mujoco.mjv_updateScene(self.model, self.data, self._option, None, view, mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        self.model.geom_group[:] = self._groups
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = int(sky)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._scene, context)
        mujoco.mjr_readPixels(raw, None, viewport, context)
        cv2.flip(raw, 0, dst=out)

    def close(self) -> None:
        """Give the OpenGL context back."""
        self._context.free()
        self._gl.free()


def _regroup(model: mujoco.MjModel, hidden: Sequence[str]) -> None:
    """Move the visible shapes of bodies whose names begin with one of `hidden` into another group."""
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        if model.geom_group[geom] in _VISUAL_GROUPS and name.startswith(tuple(hidden)):
            model.geom_group[geom] = _HIDDEN_GROUP


class Sensor:
    """A camera's sensor: it adds Gaussian noise of `sigma` grey levels to pictures of one size.

    Every exposure differs, also of a still scene, so that a frame delivered twice can be told from two frames.
    """

    def __init__(self, width: int, height: int, sigma: float):
        self._random = np.random.default_rng(0)
        self._lighter, self._darker = _noise(width, height, sigma)

    def expose(self, clean: np.ndarray, out: np.ndarray) -> None:
        """One exposure of the picture `clean` into `out`, both (height, width, 3) uint8."""
        height, width, _ = clean.shape
        top, left = self._random.integers(_MARGIN, size=2)
        cut = (slice(top, top + height), slice(left, left + width))
        cv2.add(clean, self._lighter[cut], dst=out)  # both end at 0 and 255
        cv2.subtract(out, self._darker[cut], dst=out)


@functools.cache
def _noise(width: int, height: int, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """What a sensor adds and what it takes away, one sheet for all cameras of a size: each exposure reads all of it."""
    sheet = np.round(np.random.default_rng(1).normal(0.0, sigma, (height + _MARGIN, width + _MARGIN, 3)))
    lighter, darker = (np.clip(sign * sheet, 0, 255).astype(np.uint8) for sign in (1.0, -1.0))
    return lighter, darker


@dataclass
class View:
    """One camera that is being drawn."""

    settings: Settings
    block: SharedBlock
    record: np.ndarray
    clean: np.ndarray
    sensor: Sensor
    due_s: float
    drawn_qpos: np.ndarray | None = None

    @property
    def period_s(self) -> float:
        return 1.0 / self.settings[3]


class Drawing:
    """All views of a rig, which simulates this scene. Raises RigError: no OpenGL, or no block of the world."""

    def __init__(self, rig: str, scene: Scene):
        self._rig = rig
        self._noise = scene.options.camera_noise
        model = build_world(scene)
        try:
            self._world = SharedBlock(rig_path(rig, "world"), world_dtype(model), create=False)
        except FileNotFoundError as error:
            raise RigError(f"rig {rig} shows no world ({error}); is it running?") from error
        leaders = [f"{arm.channel}/" for arm in scene.arms if arm.role == "leader"]
        self._painter = Painter(model, hidden=leaders)
        amount, props = scene.options.randomise_look, [thing.name for thing in scene.props]
        scenery = ["world", *(thing.name for thing in scene.furniture)]
        self._look = Look(model, amount, props, scenery) if amount else None
        self._look_seed: int | None = None
        self._views: dict[Settings, View] = {}
        self._stalled_until_s: dict[str, float] = {}

    def open(self, settings: Settings) -> None:
        """Start drawing a camera; its block exists when this returns. Does nothing where it is drawn already."""
        if settings in self._views:  # a second client asked before the first was answered
            return
        _, width, height, _ = settings
        dtype, now = frame_dtype(width, height), time.monotonic()
        block = SharedBlock(frame_path(self._rig, *settings), dtype, create=True)
        clean, sensor = np.zeros((height, width, 3), np.uint8), Sensor(width, height, self._noise)
        self._views[settings] = View(settings, block, np.zeros((), dtype), clean, sensor, now)
        self.draw_due(now)

    def close(self, settings: Settings) -> None:
        """Stop drawing a camera and remove its block."""
        view = self._views.pop(settings, None)
        if view is not None:
            view.block.close()

    def stall(self, camera: str, until_s: float) -> None:
        """Publish no frame of a camera before a monotonic time."""
        self._stalled_until_s[camera] = until_s

    def close_all(self) -> None:
        """Remove every block and give OpenGL back."""
        for settings in list(self._views):
            self.close(settings)
        self._world.close()
        self._painter.close()

    def next_due_s(self) -> float | None:
        """Monotonic time of the next frame, None without cameras."""
        return min((view.due_s for view in self._views.values()), default=None)

    def draw_due(self, now_s: float) -> None:
        """Draw and publish every view whose time has come, all from one state of the world while that is new."""
        due = [view for view in self._views.values() if view.due_s <= now_s]
        for view in due:
            view.due_s = _next_beat(now_s, view.period_s)  # late frames are skipped: no burst
        self._draw([view for view in due if self._stalled_until_s.get(view.settings[0], 0.0) <= now_s])

    def draw_all(self) -> None:
        """Draw and publish every view."""
        self._draw(list(self._views.values()))

    def begin_anew(self) -> None:
        """The world has been restarted: so are the sensors' noise and the frames' times."""
        for view in self._views.values():
            _, width, height, _ = view.settings
            view.sensor, view.drawn_qpos = Sensor(width, height, self._noise), None
            view.record["stamp_s"] = 0.0

    def _draw(self, views: list[View]) -> None:
        state, read_s = None, -math.inf
        posed = False
        for view in views:
            if time.monotonic() - read_s > view.period_s:  # at once, or on a machine that has no time for us
                state, read_s, posed = self._world.read(), time.monotonic(), False
            if state is None or float(state["stamp_s"]) <= float(view.record["stamp_s"]):
                continue  # nothing new to show; the frame's age tells
            if self._look is not None and int(state["look_seed"]) != self._look_seed:
                self._take_look(self._look, int(state["look_seed"]))
                posed = False
            qpos = state["qpos"]
            if view.drawn_qpos is None or np.abs(qpos - view.drawn_qpos).max() > _UNCHANGED:
                if not posed:
                    self._painter.pose(qpos)
                    posed = True
                name = view.settings[0]
                self._painter.paint(name, view.clean, show_hidden=name in _ALL_SEEING)
                view.drawn_qpos = qpos
            view.sensor.expose(view.clean, view.record["rgb"])
            view.record["stamp_s"], view.record["sim_s"] = state["stamp_s"], state["sim_s"]
            view.record["number"] += 1
            view.block.write(view.record)

    def _take_look(self, look: Look, seed: int) -> None:
        look.take(seed)
        self._look_seed = seed
        for view in self._views.values():
            view.drawn_qpos = None


def _next_beat(now_s: float, period_s: float) -> float:
    """The next multiple of the period: cameras of one rate show the same instant, from one state."""
    return (int(now_s / period_s + 1e-6) + 1) * period_s
