"""Gamepad that drives a mobile base, as a LeRobot teleoperator."""

import itertools
import logging
import time
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.constants import HF_LEROBOT_CALIBRATION, TELEOPERATORS
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.base_drive import BaseDrive
from lerobot_robot_yam.face.driving.drive_options import PadOptions
from lerobot_robot_yam.face.driving.pad_calibration import RATE_HZ, record_map
from lerobot_robot_yam.face.driving.pad_map import PadMap, load_map
from lerobot_robot_yam.face.driving.pad_watch import PadWatch
from lerobot_robot_yam.face.driving.sdl_pads import Pad, Reading, open_pad
from lerobot_robot_yam.face.recorder.kept_episodes import saves_finished_episode
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.uncopyable import Uncopied
from lerobot_teleoperator_yam.config_yam_gamepad import YamGamepadConfig

logger = logging.getLogger(__name__)


def map_path(pad: Pad, calibration_dir: Path | None) -> Path:
    """Return the file with a pad's map. All teleoperators with a gamepad share it."""
    directory = calibration_dir or HF_LEROBOT_CALIBRATION / TELEOPERATORS / YamGamepad.name
    return directory / "yam" / f"{pad.guid}_pad.json"  # a subdirectory, whose files LeRobot never reads


def watch_pad(device: str, options: PadOptions, calibration_dir: Path | None, stop: EmergencyStop) -> PadWatch:
    """Open the gamepad of a device.

    Raises:
        ConfigError: pygame-ce is missing; there is no pad, or more than one; or the pad is not calibrated.
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
    return PadWatch(find, (zone, zone, zone, options.rail_dead_zone), options.expo, stop)


class YamGamepad(Uncopied, Teleoperator):
    """Gamepad for a base, with or without a rail. See docs/gamepad.md."""

    config_class = YamGamepadConfig
    name = "yam_gamepad"

    def __init__(self, config: YamGamepadConfig):
        super().__init__(config)
        self.config = config
        self._watch: PadWatch | None = None
        self._drive: BaseDrive | None = None

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Features `x.vel`, `y.vel` (m/s), `theta.vel` (deg/s); with the option `rail`, `height.vel` (m/s)."""
        return dict.fromkeys(self.config.drive_keys(), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """Empty mapping: feedback cannot move a stick."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether `connect` was called and `disconnect` was not. A pad that is unplugged does not count."""
        return self._drive is not None

    @property
    def is_calibrated(self) -> bool:
        """Always True: `connect` refuses a pad that needs a calibration."""
        return True

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Open the gamepad; energise nothing.

        Args:
            calibrate: False before a calibration (lerobot-calibrate): the pad may be unknown, and is opened later.

        Raises:
            ConfigError: pygame-ce is missing; there is no pad, or more than one; or the pad is not calibrated.
            LifeCycleError: a stick is off its rest.
        """
        stop = EmergencyStop()
        if calibrate:
            watch = watch_pad(self.name, self.config, self.config.calibration_dir, stop)
            try:
                watch.check_rest(self.name)
            except BaseException:
                watch.close()
                raise
            watch.start()
            self._watch = watch
        self._drive = BaseDrive(self.name, self.config, stop)
        logger.info("%s connected", self)

    def disconnect(self) -> None:
        """Release the gamepad. Idempotent."""
        watch, self._watch, self._drive = self._watch, None, None
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

    def configure(self) -> None:
        """Do nothing: there is nothing to configure."""

    @check_if_not_connected
    @saves_finished_episode
    def get_action(self) -> dict[str, float]:
        """Return the velocities that the sticks ask for; zeros while the pad is unplugged, see `BaseDrive`."""
        assert self._drive is not None and self._watch is not None
        return self._drive.action(self._watch.asked())

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Do nothing: feedback cannot move a stick."""


def _readings(pad: Pad) -> Iterator[Reading]:
    """Yield `RATE_HZ` readings per second. Raises ConfigError: the pad is unplugged."""
    begin_s = time.monotonic()
    for number in itertools.count(1):
        reading = pad.read()
        if reading is None:
            raise ConfigError(f"{pad.name} was unplugged; nothing was stored")
        yield reading
        time.sleep(max(begin_s + number / RATE_HZ - time.monotonic(), 0.0))
