"""File that keeps what homing has learnt, and where the carriage was when its brake took it.

A motor counts its turns only while it has power. So the height is known without homing only if the angle is still the
stored one; the angle is taken out of the file while the rail may move.
"""

import json
import logging
import math
from dataclasses import asdict, dataclass, replace

from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.mobile.rail_profile import METRES_PER_RAD, RAIL_MOTOR, RailScale
from lerobot_robot_yam.system.paths import user_path, write_whole

logger = logging.getLogger(__name__)

_SAME_RAD = 0.05  # difference of two angles of a carriage that has not moved, rad
_TRAVEL_TOLERANCE = 0.03  # maximum difference of two measured travels, as a share
_PERIOD_RAD = 2.0 * motor_type(RAIL_MOTOR.type).position_max_rad  # interval at which readings repeat, rad


@dataclass(frozen=True)
class RailCalibration:
    """Content of the file: travel between the switches in m and rad, and the last place, None while it may move."""

    stroke_m: float
    travel_rad: float
    angle_rad: float | None = None
    height_m: float = 0.0

    @property
    def metres_per_rad(self) -> float:
        return self.stroke_m / self.travel_rad

    def scale(self, q: float) -> RailScale | None:
        """Return the scale if the carriage is where it was left; None: home it. q: present angle, rad."""
        if self.angle_rad is None or abs(math.remainder(q - self.angle_rad, _PERIOD_RAD)) > _SAME_RAD:
            return None
        return RailScale(self.metres_per_rad, q - self.height_m / self.metres_per_rad)


def check_travel(name: str, found: RailCalibration, known: RailCalibration | None) -> None:
    """Check what homing has found. Raises MotorError: it is not the travel of a rail, or not as earlier."""
    where, (low, high) = f"{name}: rail: {found.travel_rad:.2f} rad between the switches", METRES_PER_RAD
    if not (found.travel_rad > 0.0 and low <= found.metres_per_rad <= high):
        raise MotorError(f"{where} cannot be {found.stroke_m:g} m; check stroke_m and both switches")
    if known is not None and abs(found.travel_rad / known.travel_rad - 1.0) > _TRAVEL_TOLERANCE:
        raise MotorError(
            f"{where}, earlier {known.travel_rad:.2f} rad: a switch is triggered too early, or the belt slips; after a "
            "repair, delete the file of calibration_path"
        )


def load(name: str, path: str | None, stroke_m: float) -> RailCalibration | None:
    """Read the file; None, with a warning in the log, if it is damaged or another rail's."""
    if path is None or not user_path(path).exists():
        return None
    try:
        found = RailCalibration(**json.loads(user_path(path).read_text()))
        values = (found.travel_rad, found.angle_rad or 0.0, found.height_m)
        if found.stroke_m != stroke_m or found.travel_rad <= 0.0 or not all(map(math.isfinite, values)):
            raise ValueError(f"it has {found}")
    except (OSError, ValueError, TypeError) as error:
        logger.warning("%s: rail: home it, since %s does not fit: %s", name, path, error)
        return None
    return found


def store(name: str, path: str, found: RailCalibration, q: float | None, height_m: float) -> None:
    """Write the file, with the place of a carriage that its brake holds. q: angle, rad; None: it may move now."""
    try:
        write_whole(user_path(path), json.dumps(asdict(replace(found, angle_rad=q, height_m=height_m))))
    except OSError as error:
        logger.error("%s: rail: %s cannot be written, so the next start homes again: %s", name, path, error)
