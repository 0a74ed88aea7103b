"""A base with a rail in lock-step with its rig: started at a height that it knows, watched while it moves."""

import json

from lerobot_robot_yam.mobile.rail_config import RailConfig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_base import YamBase

STROKE_M, M_PER_RAD, ZERO_RAD = 1.0, 0.03, 2.0  # the rig's rail
SCENE = "extends: mobile\nname: rail\nbase: {{channel: base, rail: {{height_m: {}, stroke_m: {}}}}}\n"
MOST_FALL_M = 0.005


class Rail:
    """A rig in lock-step whose carriage stands at a height; it is known by its calibration file, if `known`."""

    def __init__(self, folder, height_m=0.5, stroke_m=STROKE_M, known=True):
        (folder / "rail.yaml").write_text(SCENE.format(height_m, stroke_m))
        self.rig, self.path, self.stroke_m = LockstepRig(folder / "rail.yaml"), folder / "rail.json", stroke_m
        self.world, self.board = self.rig.device.world, self.rig.device.board
        if known:
            calibrated(self.path, height_m, stroke_m)
        self.lowest_m = height_m
        self.rig.device.each_advance.append(self._look)

    def move(self, height_m):
        """Move the carriage by hand, with its brake."""
        self.world.data.joint("base/rail").qpos[0] = height_m
        self.world.model.eq_data[self.world.model.equality("base/brake").id, 0] = (
            height_m  # the brake has gripped there
        )
        self.world.refresh()

    def _look(self):
        self.lowest_m = min(self.lowest_m, self.board.height_m)

    @property
    def height_m(self):
        return self.board.height_m

    def base(self, isolation="lockstep", **fields):
        rail = RailConfig(io="sim", calibration_path=str(self.path), stroke_m=self.stroke_m, **fields)
        return YamBase(
            channel="base",
            interface="yam_lockstep",
            can_options={"rig": self.rig.name},
            isolation=isolation,
            rail=rail,
        )

    def watch_fall(self):
        """Begin to watch how far the carriage falls from where it is."""
        self._from_m = self.lowest_m = self.height_m

    @property
    def fallen_m(self):
        return self._from_m - self.lowest_m

    @property
    def enabled(self):
        return self.rig.state()["base"]["motors"]["rail"]["enabled"]


def calibrated(path, height_m, stroke_m):
    """Write the calibration file of a carriage that was left at a height."""
    place = {"angle_rad": ZERO_RAD + height_m / M_PER_RAD, "height_m": height_m}
    path.write_text(json.dumps({"stroke_m": stroke_m, "travel_rad": stroke_m / M_PER_RAD} | place))


def lift(base, velocity, seconds):
    """Command the rail's velocity for a while."""
    for _ in range(round(seconds / 0.05)):
        base.set_rail_velocity(velocity)
        base.clock.sleep(0.05)
