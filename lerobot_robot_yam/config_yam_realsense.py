"""LeRobot config of a RealSense camera with automatic reconnection (`type: yam_realsense`)."""

import sys
from dataclasses import dataclass
from pathlib import Path

from lerobot.cameras.configs import CameraConfig, ColorMode, Cv2Rotation

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.registration import register_as
from lerobot_robot_yam.system.paths import user_path


@register_as(CameraConfig, "yam_realsense")
@dataclass(kw_only=True)
class YamRealsenseCameraConfig(CameraConfig):
    """A D405, D435, D455 or other camera with a serial number. The fields are as in LeRobot's `intelrealsense`."""

    serial_number_or_name: str = option("serial number (`yam-cameras list`), or the model if there is one: D405")
    fps: int | None = option("images per second", None)
    width: int | None = option("of the images, pixels, after the rotation", None)
    height: int | None = option("of the images, pixels, after the rotation", None)
    color_mode: ColorMode = option("rgb or bgr", ColorMode.RGB)
    use_rgb: bool = option("give colour", True)
    use_depth: bool = option("give depth too, in mm, as <name>_depth; takes librealsense", False)
    rotation: Cv2Rotation = option("of the images, degrees: 0, 90, 180 or -90", Cv2Rotation.NO_ROTATION)
    warmup_s: int = option("seconds that connecting waits for exposure and white balance to settle", 1)
    exposure: int | None = option(
        "manual exposure: µs on a D405, where it is depth's too, 100 µs on other cameras; without it as the camera has "
        "it. `yam-cameras tune` finds one",
        None,
    )
    gain: int | None = option("manual gain, as the camera counts it; without it as the camera has it", None)
    white_balance: int | None = option("manual white balance, K; without it as the camera has it", None)
    root: str = option("directory with sys and dev, in place of this computer's: for tests", "/")

    def __post_init__(self) -> None:
        """Check the values and, under a LeRobot command, whether the camera exists.

        Raises:
            RefusedConfigError: a value is invalid or the camera is missing; the message says what to do.
        """
        # late import, for a fast start of LeRobot
        from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError

        self.color_mode, self.rotation = ColorMode(self.color_mode), Cv2Rotation(self.rotation)
        if not self.use_rgb and not self.use_depth:
            raise RefusedConfigError(f"camera {self.serial_number_or_name}: set use_rgb or use_depth")
        given = [value is not None for value in (self.fps, self.width, self.height)]
        if any(given) and not all(given):
            raise RefusedConfigError(
                f"camera {self.serial_number_or_name}: give fps, width and height, or none of them"
            )
        if Path(*sys.argv[:1]).stem.startswith("lerobot"):
            self._find()

    def _find(self) -> None:
        from lerobot_robot_yam.cameras.opening import find_camera
        from lerobot_robot_yam.cameras.picture_source import no_depth
        from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError

        try:
            camera = find_camera(self.serial_number_or_name, user_path(self.root))
            if self.use_depth and camera.device is None:
                raise no_depth(str(camera))
        except YamError as error:
            raise RefusedConfigError(str(error)) from error
