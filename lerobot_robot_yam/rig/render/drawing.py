"""Open cameras of a rig: schedule, state, look, noise and frame output of each."""

import functools
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.client.launch import rig_path
from lerobot_robot_yam.rig.client.rendered_camera import Settings, frame_dtype, frame_path
from lerobot_robot_yam.rig.render.painter import Painter
from lerobot_robot_yam.rig.scene.scene import Scene
from lerobot_robot_yam.rig.world.world_model import build_world, world_dtype
from lerobot_robot_yam.system.shared_block import SharedBlock

# Spreads of random looks: maximum change from the usual look in either direction, at `amount` 1.
_LIGHT_TURN = 0.30  # change of the horizontal components of a light's direction with vertical component 1
_LIGHT_LEVEL = 0.25  # relative change of a light's level
_HEADLIGHT_LEVEL = 0.12
_WARMTH = 0.06  # fraction of red added and of blue removed
_SCENERY_COLOUR, _THING_COLOUR = 0.10, 0.05  # change of all channels, 0 … 1; plus `_HUE` times as much per channel
_CAMERA_M, _CAMERA_RAD = 0.02, 0.05  # change of a camera's pose along and about each axis
_HUE = 0.4
_ON_AN_ARM = 0.5  # factor on the pose changes of cameras mounted on an arm
_FIELDS = ("light_dir", "light_diffuse", "geom_rgba", "cam_pos", "cam_quat")
_UNCHANGED = 1e-6  # maximum change of each joint, rad or m, at which the last image is reused
_ALL_SEEING = ("overview",)  # cameras that also show the leaders
_MARGIN = 64  # pixels by which the noise sheet exceeds the image, so that each exposure uses a random section


class Look:
    """Usual look of a model, and random variations of light, colours and camera poses, drawn from a seed.

    A look affects only images. A policy trained on many looks depends less on any one of them.

    Args:
        model: model whose lights, colours and cameras are changed.
        amount: 0 … 1, factor on the spreads above.
        things: bodies whose colours vary only slightly, because colours identify things.
        scenery: bodies whose colours vary more.
    """

    def __init__(self, model: mujoco.MjModel, amount: float, things: Iterable[str], scenery: Iterable[str]):
        self._model, self._amount = model, amount
        self._colour_spread = np.zeros((model.nbody, 1))
        for names, width in ((things, _THING_COLOUR), (scenery, _SCENERY_COLOUR)):
            for name in names:
                self._colour_spread[model.body(name).id] = width
        self._usual = {key: getattr(model, key).copy() for key in _FIELDS}
        head = model.vis.headlight
        self._ambient, self._diffuse = head.ambient.copy(), head.diffuse.copy()

    def take(self, seed: int) -> None:
        """Change the model to the look of `seed`."""
        model, usual = self._model, self._usual
        random = np.random.default_rng(seed)

        def drawn(width: float | np.ndarray, *shape: int) -> np.ndarray:
            spread: np.ndarray = self._amount * width * random.uniform(-1.0, 1.0, shape)
            return spread

        direction = usual["light_dir"] / -usual["light_dir"][:, 2:]
        direction[:, :2] += drawn(_LIGHT_TURN, model.nlight, 2)
        model.light_dir[:] = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        tint = 1.0 + drawn(_WARMTH, 1) * np.array([1.0, 0.0, -1.0])
        model.light_diffuse[:] = usual["light_diffuse"] * (1.0 + drawn(_LIGHT_LEVEL, model.nlight, 1)) * tint
        model.vis.headlight.ambient[:] = self._ambient * (1.0 + drawn(_HEADLIGHT_LEVEL, 1)) * tint
        model.vis.headlight.diffuse[:] = self._diffuse * (1.0 + drawn(_HEADLIGHT_LEVEL, 1))
        shade, hue = drawn(self._colour_spread, model.nbody, 1), drawn(_HUE * self._colour_spread, model.nbody, 3)
        colours = usual["geom_rgba"][:, :3] + (shade + hue)[model.geom_bodyid]
        model.geom_rgba[:, :3] = np.clip(colours, 0.0, 1.0)
        for camera, body in enumerate(model.cam_bodyid):
            part = _ON_AN_ARM if body else 1.0
            model.cam_pos[camera] = usual["cam_pos"][camera] + drawn(part * _CAMERA_M, 3)
            quat = usual["cam_quat"][camera].copy()
            mujoco.mju_quatIntegrate(quat, drawn(part * _CAMERA_RAD, 3), 1.0)
            model.cam_quat[camera] = quat


class Sensor:
    """Sensor of a camera: adds Gaussian noise of `sigma` grey levels to images of one size.

    Each exposure differs, even for a static scene, so that a new frame can be told from a repeated one.
    """

    def __init__(self, width: int, height: int, sigma: float):
        self._random = np.random.default_rng(0)
        self._lighter, self._darker = _noise(width, height, sigma)

    def expose(self, clean: np.ndarray, out: np.ndarray) -> None:
        """Write the image `clean` with noise to `out`, both (height, width, 3) uint8."""
        height, width, _ = clean.shape
        top, left = self._random.integers(_MARGIN, size=2)
        cut = (slice(top, top + height), slice(left, left + width))
        cv2.add(clean, self._lighter[cut], dst=out)  # both calls saturate at 0 and 255
        cv2.subtract(out, self._darker[cut], dst=out)


@functools.cache
def _noise(width: int, height: int, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the noise that a sensor adds and that it subtracts; cached and shared by cameras of the same size."""
    sheet = np.round(np.random.default_rng(1).normal(0.0, sigma, (height + _MARGIN, width + _MARGIN, 3)))
    lighter, darker = (np.clip(sign * sheet, 0, 255).astype(np.uint8) for sign in (1.0, -1.0))
    return lighter, darker


@dataclass
class View:
    """One open camera and its frame block."""

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
    """All open cameras of a rig. Raises RigError: there is no OpenGL, or no world block."""

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
        """Start rendering a camera; its block exists on return. Does nothing if the camera is already open."""
        if settings in self._views:  # a second client requested the camera before the first got its reply
            return
        _, width, height, _ = settings
        dtype, now = frame_dtype(width, height), time.monotonic()
        block = SharedBlock(frame_path(self._rig, *settings), dtype, create=True)
        clean, sensor = np.zeros((height, width, 3), np.uint8), Sensor(width, height, self._noise)
        self._views[settings] = View(settings, block, np.zeros((), dtype), clean, sensor, now)
        self.draw_due(now)

    def close(self, settings: Settings) -> None:
        """Stop rendering a camera and remove its block."""
        view = self._views.pop(settings, None)
        if view is not None:
            view.block.close()

    def stall(self, camera: str, until_s: float) -> None:
        """Publish no frames of a camera before the monotonic time `until_s`."""
        self._stalled_until_s[camera] = until_s

    def close_all(self) -> None:
        for settings in list(self._views):
            self.close(settings)
        self._world.close()
        self._painter.close()

    def next_due_s(self) -> float | None:
        """Return the monotonic time at which the next frame is due; None without cameras."""
        return min((view.due_s for view in self._views.values()), default=None)

    def draw_due(self, now_s: float) -> None:
        """Render and publish the views that are due, all from one world state while that state is recent."""
        due = [view for view in self._views.values() if view.due_s <= now_s]
        for view in due:
            view.due_s = _next_beat(now_s, view.period_s)  # late frames are skipped, not drawn in a burst
        self._draw([view for view in due if self._stalled_until_s.get(view.settings[0], 0.0) <= now_s])

    def draw_all(self) -> None:
        self._draw(list(self._views.values()))

    def begin_anew(self) -> None:
        """Reset the sensors' noise and the frame timestamps after a restart of the world."""
        for view in self._views.values():
            _, width, height, _ = view.settings
            view.sensor, view.drawn_qpos = Sensor(width, height, self._noise), None
            view.record["stamp_s"] = 0.0

    def _draw(self, views: list[View]) -> None:
        state, read_s = None, -math.inf
        posed = False
        for view in views:
            if time.monotonic() - read_s > view.period_s:  # first view, or after a pause on a busy machine
                state, read_s, posed = self._world.read(), time.monotonic(), False
            if state is None or float(state["stamp_s"]) <= float(view.record["stamp_s"]):
                continue  # no new state: the old timestamp reveals this
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
    """Return the next multiple of the period, so that cameras with the same rate show the same state."""
    return (int(now_s / period_s + 1e-6) + 1) * period_s
