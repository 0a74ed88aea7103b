"""Gamepad that drives a mobile base, as a LeRobot teleoperator."""

import itertools
import logging
import time
from collections.abc import Iterator
from pathlib import Path

from lerobot.utils.constants import HF_LEROBOT_CALIBRATION, TELEOPERATORS
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.base_drive import BaseDrive
from lerobot_robot_yam.face.driving.drive_options import PadOptions
from lerobot_robot_yam.face.driving.pad_calibration import RATE_HZ, record_map
from lerobot_robot_yam.face.driving.pad_map import PadMap, load_map
from lerobot_robot_yam.face.driving.pad_watch import PadWatch
from lerobot_robot_yam.face.driving.sdl_pads import Pad, Reading, open_pad
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_teleoperator_yam.config_yam_gamepad import YamGamepadConfig
from lerobot_teleoperator_yam.drive_teleoperator import DriveTeleoperator

logger = logging.getLogger(__name__)


def map_path(pad: Pad, calibration_dir: Path | None) -> Path:
    """Return the file with a pad's map. All teleoperators with a gamepad share it."""
    directory = calibration_dir or HF_LEROBOT_CALIBRATION / TELEOPERATORS / YamGamepad.name
    return directory / "yam" / f"{pad.guid}_pad.json"  # a subdirectory, whose files LeRobot never reads


def watch_pad(device: str, options: PadOptions, calibration_dir: Path | None, stop: EmergencyStop) -> PadWatch:
    """Open the gamepad of a device, and watch it.

    Raises:
        ConfigError: pygame-ce is missing; there is no pad, or more than one; or the pad is not calibrated.
        LifeCycleError: a stick is off its rest.
    """
    wanted = options.pad

    def find() -> tuple[Pad, PadMap]:
        nonlocal wanted
        pad = open_pad(device, wanted)
        wanted = pad.guid  # a pad that comes back is the same model
        try:
            return pad, load_map(pad, map_path(pad, calibration_dir))
        except ConfigError:
            pad.close()
            raise

    zone = options.dead_zone
    watch = PadWatch(find, (zone, zone, zone, options.rail_dead_zone), options.expo, stop)
    try:
        watch.check_rest(device)
    except BaseException:
        watch.close()
        raise
    watch.start()
    return watch


class YamGamepad(DriveTeleoperator):
    """Gamepad for a base, with or without a rail. See docs/gamepad.md."""

    config_class = YamGamepadConfig
    name = "yam_gamepad"

    config: YamGamepadConfig
    _driver: PadWatch | None = None

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Open the gamepad; energise nothing.

        Args:
            calibrate: False before a calibration (lerobot-calibrate): the pad may be unknown, and is opened later.

        Raises:
            ConfigError, LifeCycleError: see `watch_pad`.
        """
        stop = EmergencyStop()
        if calibrate:
            self._driver = watch_pad(self.name, self.config, self.config.calibration_dir, stop)
        self._drive = BaseDrive(self.name, self.config, stop)
        logger.info("%s connected", self)

    def disconnect(self) -> None:
        """Release the gamepad. Idempotent."""
        watch, self._driver, self._drive = self._driver, None, None
        if watch is not None:
            watch.close()

    @check_if_not_connected
    def calibrate(self) -> None:
        """Ask for each stick and button of the pad in turn, and store the map.

        Raises:
            ConfigError: there is no pad, or more than one; or the person did not do what was asked. Nothing is stored.
        """
        pad = open_pad(self.name, self.config.pad)
        try:
            found = record_map(_readings(pad), lambda text: logger.info("%s: %s", pad.name, text), self.config.rail)
            path = map_path(pad, self.config.calibration_dir)
            found.save(pad, path)
            logger.info("%s: sticks and buttons stored in %s", pad.name, path)
        finally:
            pad.close()


def _readings(pad: Pad) -> Iterator[Reading]:
    """Yield `RATE_HZ` readings per second. Raises ConfigError: the pad is unplugged."""
    begin_s = time.monotonic()
    for number in itertools.count(1):
        reading = pad.read()
        if reading is None:
            raise ConfigError(f"{pad.name} was unplugged; nothing was stored")
        yield reading
        time.sleep(max(begin_s + number / RATE_HZ - time.monotonic(), 0.0))
