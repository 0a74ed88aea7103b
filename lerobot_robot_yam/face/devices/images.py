"""Cameras of a run config: finding the rig of a rendered camera, opening a camera, and reading the newest images.

Reading waits for images that are slightly late.
"""

import dataclasses
import importlib
import logging
import math
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import draccus
import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs

from lerobot_robot_yam.arm.config import ChannelConfig
from lerobot_robot_yam.errors import CameraError, ConfigError, StaleStateError
from lerobot_robot_yam.rig.scene.scene import Options
from lerobot_robot_yam.system.runtime_files import rig_name

logger = logging.getLogger(__name__)

# Maximum age of a fresh image, s; the second for slow cameras. A busy machine or USB bus delays images now and then,
# which should not end a recording. While this program waits, the processes that deliver images get the machine.
_FRESH_S, _FRESH_SLOW_S = 0.2, 0.4
_FRESH_FRAMES = 2.0  # maximum age of a fresh image in frames of a slow camera, up to _FRESH_SLOW_S
LATE_S = 0.6  # waiting time after which LeRobot's own limit of an image's age applies, s
# Age of an image at which its camera counts as dead, ms. A dead camera is reported within the second promised by
# docs/faults.md if this process gets CPU time. While other processes use the machine, all cameras are merely slow.
_DEAD_MS = 800
PATIENCE_S = 3.0  # maximum wait for a fresh image, s
_GLANCE_S = 0.005  # pause before a late image is read again, s
_RENEWAL_S = 0.011  # maximum wait for an image that is due, s: a third of LeRobot's period, less than LeRobot sleeps
_RENEWAL_FRAMES = 1 / 3  # last part of a camera's period, as a fraction, in which the next image is due
_POLL_S = 0.001  # pause between two reads of an image that is due, s
_SAMPLE = 8  # step between compared rows and columns, pixels
_ASLEEP_S = 0.1  # time between two reads from which other processes must have used the machine, s
_TOLD_S = 30.0  # minimum time between two warnings about late images, s: on a busy machine each read waits
_REGISTER = ("lerobot.cameras.opencv", "lerobot.cameras.realsense")  # modules that LeRobot's commands import, too
_SCENE_OPTIONS = {field.name for field in dataclasses.fields(Options)}


def beside_arms(camera: Any, arms: Iterable[ChannelConfig]) -> Any:
    """Return a camera's config with the rig of a robot's virtual arms, unless the config names another rig.

    The camera may be the first to start that rig. Configs of other camera types are returned unchanged.
    """
    said = next((arm.can_options for arm in arms if arm.interface == "yam_sim"), None)
    if said is None or camera.type != "yam_sim" or camera.rig != "auto":
        return camera
    options = {key: value for key, value in said.items() if key in _SCENE_OPTIONS}
    return dataclasses.replace(
        camera,
        rig=rig_name(said.get("rig"))[0],
        scene=camera.scene or said.get("scene"),
        rig_options=camera.rig_options or options,
    )


def open_camera(name: str, options: Mapping[str, Any], arms: Iterable[ChannelConfig] = ()) -> Camera:
    """Open and connect a camera. The caller disconnects it.

    Args:
        name: the camera's name in messages.
        options: options of the camera as in a run config, with its type.
        arms: arms of that config; a camera `yam_sim` shows their rig.

    Raises:
        ConfigError: LeRobot does not accept these options.
        CameraError: the camera cannot be opened.
    """
    for module in _REGISTER:
        importlib.import_module(module)
    try:
        config = beside_arms(draccus.decode(CameraConfig, dict(options)), arms)
    except Exception as error:  # draccus can raise any exception
        raise ConfigError(f"camera {name}: {error}") from error
    try:
        (camera,) = make_cameras_from_configs({name: config}).values()
        camera.connect()
    except Exception as error:  # camera drivers can raise any exception
        raise CameraError(f"camera {name} cannot be opened: {error}; does another program use it?") from error
    return camera


def newest_images(cameras: Mapping[str, Camera], configs: Mapping[str, CameraConfig]) -> tuple[dict[str, Any], str]:
    """Read all cameras, and repeat while an image is older than 0.2 s (two frames of a slow camera).

    After `LATE_S` of waiting, images within LeRobot's limit (0.5 s) count as fresh. A camera counts as dead only after
    `LATE_S` in which no other process kept this process from running for 0.1 s.

    Returns:
        Images by feature name, depth as `<name>_depth`; and the message about a wait, empty without a wait.

    Raises:
        StaleStateError: a camera has no image, or its image is older than 0.8 s, or was late for `PATIENCE_S`.
    """
    begin = glance = time.monotonic()
    waited_s = watched_s = 0.0
    late = ""
    while True:
        try:
            images = _read(cameras, configs, _fresh_ms if waited_s < LATE_S else None)
            break
        except StaleStateError as error:
            # The cause is a TimeoutError for an old image, but not for a disconnected camera.
            if not isinstance(error.__cause__, TimeoutError) or waited_s > PATIENCE_S:
                raise
            late = str(error.__cause__)
        time.sleep(_GLANCE_S)
        last, glance = glance, time.monotonic()
        gap_s = glance - last
        waited_s += min(gap_s, _ASLEEP_S)
        watched_s = watched_s + gap_s if gap_s < _ASLEEP_S else 0.0
        if watched_s >= LATE_S:
            _read(cameras, configs, lambda _: _DEAD_MS)
    return images, f"waited {(time.monotonic() - begin) * 1e3:.0f} ms for images: {late}" if late else ""


class ImageReader:
    """Reader of the newest images of cameras, which reads each image only once if possible.

    Cameras and control loop have the same rate, but drift. At times one image arrives just before a read and the next
    just after the following read, so an image would be read twice. Therefore a read waits up to a third of a frame for
    an image that is due.
    """

    def __init__(self, cameras: Mapping[str, Camera], configs: Mapping[str, CameraConfig]):
        self._cameras, self._configs = cameras, configs
        self._images: dict[str, Any] = {}
        self._new_s: dict[str, float] = {}  # time of the first read of each camera's image
        # time of the last warning about a wait, number of waits since that warning
        self._told_s, self._untold = -math.inf, 0

    def read(self) -> tuple[dict[str, Any], bool]:
        """Return the images of `newest_images`, and whether this call has waited for any."""
        images, late = newest_images(self._cameras, self._configs)
        waited = bool(late)
        if late:
            self._tell(late)
        begin = now = time.monotonic()
        due = {name: camera for name, camera in self._cameras.items() if self._is_due(name, images, now)}
        while due and now - begin < _RENEWAL_S:
            time.sleep(_POLL_S)
            waited, now = True, time.monotonic()
            try:
                images |= _read(due, self._configs, None)
            except StaleStateError:  # the next call raises this error again if the image is still missing
                break
            due = {name: camera for name, camera in due.items() if self._is_due(name, images, now)}
        for name in self._cameras:
            if name not in self._new_s or not self._is_repeated(name, images):
                self._new_s[name] = now
        self._images = images
        return images, waited

    def _tell(self, late: str) -> None:
        """Warn about a wait at once, then at most every `_TOLD_S`."""
        self._untold += 1
        if time.monotonic() - self._told_s > _TOLD_S:
            also = f" (and {self._untold - 1} times since this was said)" if self._untold > 1 else ""
            logger.warning("%s%s", late, also)
            self._told_s, self._untold = time.monotonic(), 0

    def _is_due(self, name: str, images: Mapping[str, Any], now_s: float) -> bool:
        """Return whether a camera still repeats its last image although the next one is due."""
        fps = getattr(self._configs[name], "fps", None)
        if not fps or name not in self._new_s or not self._is_repeated(name, images):
            return False
        return (now_s - self._new_s[name]) * fps >= 1.0 - _RENEWAL_FRAMES

    def _is_repeated(self, name: str, images: Mapping[str, Any]) -> bool:
        key = name if name in images else f"{name}_depth"
        before, image = self._images.get(key), images.get(key)
        if before is image or before is None or image is None:
            return before is image
        return np.array_equal(before[::_SAMPLE, ::_SAMPLE], image[::_SAMPLE, ::_SAMPLE])


def _read(
    cameras: Mapping[str, Camera],
    configs: Mapping[str, CameraConfig],
    max_age_ms: Callable[[CameraConfig], int] | None,
) -> dict[str, Any]:
    images = {}
    for name, camera in cameras.items():
        config = configs[name]
        limit = {} if max_age_ms is None else {"max_age_ms": max_age_ms(config)}
        try:
            if getattr(config, "use_rgb", True):
                images[name] = camera.read_latest(**limit)
            if getattr(config, "use_depth", False):
                images[f"{name}_depth"] = camera.read_latest_depth(**limit)
        except Exception as error:
            raise StaleStateError(f"camera {name} has no image: {error}; the arms hold their pose") from error
    return images


def _fresh_ms(config: CameraConfig) -> int:
    fps = getattr(config, "fps", None)
    return int(1e3 * min(max(_FRESH_S, _FRESH_FRAMES / fps if fps else 0.0), _FRESH_SLOW_S))
