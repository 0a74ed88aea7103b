"""The images of an observation: the newest of every camera, and some patience with one that is late."""

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any

from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import CameraConfig

from lerobot_robot_yam.errors import StaleStateError

logger = logging.getLogger(__name__)

# A busy machine or USB bus makes images late now and then, and a recording should outlive that. Who waits leaves the
# machine to those who make the images; who goes on with old ones, up to the 0.5 s that LeRobot takes, keeps it busy.
_FRESH_S, _FRESH_SLOW_S = 0.2, 0.4
_FRESH_FRAMES = 2.0  # of a slow camera
LATE_S = 0.6  # from then on, what LeRobot takes will do
# A camera whose image is so old is dead, and told of within the second that docs/faults.md promises, if the machine
# lets us watch. Others are merely slow, as all are while somebody else has the machine.
_DEAD_MS = 800
PATIENCE_S = 3.0
_GLANCE_S = 0.005
_ASLEEP_S = 0.1  # between two glances, or more: somebody else had the machine, and the cameras no chance either


def newest_images(cameras: Mapping[str, Camera], configs: Mapping[str, CameraConfig]) -> tuple[dict[str, Any], bool]:
    """Read every camera; where an image is older than 0.2 s (two frames, of a slow one) all are read again.

    After `LATE_S`, images that are younger than their cameras take (0.5 s) will do. A camera is called dead only after
    a watch that was awake for so long: where this process got no time for 0.1 s, it begins anew.

    Args:
        cameras, configs: by feature name.

    Returns:
        Images by feature name, depth as `<name>_depth`; and whether one was waited for.

    Raises:
        StaleStateError: a camera has no image, or its image is older than 0.8 s, or too old for `PATIENCE_S`; names it.
    """
    begin = glance = time.monotonic()
    waited_s = watched_s = 0.0
    late = ""
    while True:
        try:
            images = _read(cameras, configs, _fresh_ms if waited_s < LATE_S else None)
            break
        except StaleStateError as error:
            # A camera that is gone does not say that its image is too old.
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
    if late:
        logger.warning("waited %.0f ms for images: %s", (time.monotonic() - begin) * 1e3, late)
    return images, bool(late)


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
