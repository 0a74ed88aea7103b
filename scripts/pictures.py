"""Draw the pictures of docs/ that show the virtual rig: by its own renderer, in lock-step, the same each time.

    scripts/run python scripts/pictures.py --out docs

rig.png: what scripts/record_sim records, below an overview. tasks.png: the four tasks. pictures.png: cameras at four
moments of a grasp. looks.png: looks that `randomise_look` draws.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from lerobot_robot_yam.rig.lockstep.lockstep_cameras import LockstepCamera
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.operator.scripts.script import make_setup

SIZE = (320, 240)  # as configs/sim/record.yaml records
TASKS = ("lift_and_place", "handover", "drawer", "insertion")
MOMENTS = ("waiting", "above", "at", "holding")
RISES_M = {"above": 0.1, "at": 0.0, "holding": 0.08}  # of the tool over where the cube lies
CUBE_M, STROKE_M = 0.04, 0.095  # widths of the cube and of the open gripper
GAP = 4  # pixels


class Studio:
    """A rig whose arms and things can be put where they look well. `scene`, `options`: see `load_scene`."""

    def __init__(self, scene: str, **options: object):
        self.rig = LockstepRig(scene, camera_noise=0.0, **options)
        row = self.rig.scene()
        self.task = row["tasks"][0]["name"] if row["tasks"] else None
        self.setup = make_setup(row, self.task or "pick_and_place")
        self._cameras: dict[tuple[str, int, int], LockstepCamera] = {}

    def lay_out(self, seed: int) -> None:
        """Begin a task, its arms at their waiting poses, open."""
        if self.task:
            self.rig.task(self.task, seed)
        for side in self.setup.planners:
            self.rig.set_pose(f"follower_{side}", self.setup.home_rad(side).tolist(), 1.0)

    def grasp(self, moment: str) -> None:
        """Put the nearest arm and the cube, which lies straight, to a moment of a grasp."""
        if moment == "waiting":
            return
        cube_m = np.array(self.rig.state()["props"]["cube"]["pos"])
        side = self.setup.nearest(cube_m)
        planner, point_m = self.setup.planners[side], cube_m + [0.0, 0.0, RISES_M[moment]]
        q = planner.pose(point_m, planner.grasp_yaw(point_m, 0.0))
        opening = CUBE_M / STROKE_M if moment == "holding" else 1.0
        self.rig.set_pose(f"follower_{side}", q.tolist(), opening)
        if moment == "holding":
            self.rig.place("cube", point_m.tolist())

    def picture(self, camera: str, size: tuple[int, int] = SIZE) -> Image.Image:
        """What a camera sees now."""
        key = (camera, *size)
        if key not in self._cameras:
            self._cameras[key] = LockstepCamera(self.rig, *key, 30)
            self._cameras[key].connect()
        self.rig.sleep(0.002)  # or it is taken for the picture that there is
        return Image.fromarray(self._cameras[key].latest()[0])

    def close(self) -> None:
        """End the rig."""
        self.rig.close()


def sheet(rows: Sequence[Sequence[Image.Image]]) -> Image.Image:
    """Pictures side by side, rows below each other."""
    width = max(sum(p.width + GAP for p in row) for row in rows) - GAP
    whole = Image.new("RGB", (width, sum(row[0].height + GAP for row in rows) - GAP), "white")
    y = 0
    for row in rows:
        x = 0
        for picture in row:
            whole.paste(picture, (x, y))
            x += picture.width + GAP
        y += row[0].height + GAP
    return whole


def rig_picture() -> Image.Image:
    """The overview, and the recorded cameras while one arm holds the cube."""
    studio = Studio("bimanual_table")
    studio.lay_out(0)
    studio.grasp("holding")
    width = 3 * SIZE[0] + 2 * GAP
    rows = [[studio.picture("overview", (width, width // 2))]]
    rows.append([studio.picture(camera) for camera in ("top", "wrist_left", "wrist_right")])
    studio.close()
    return sheet(rows)


def tasks_picture() -> Image.Image:
    """The four tasks, laid out, from the front."""
    found = []
    for task in TASKS:
        studio = Studio(task)
        studio.lay_out(1)
        found.append(studio.picture("front", (480, 360)))
        studio.close()
    return sheet([found[:2], found[2:]])


def moments_picture() -> Image.Image:
    """Cameras (rows) at the moments of a grasp (columns)."""
    cameras = ("top", "wrist_left", "wrist_right", "front")
    columns = []
    for moment in MOMENTS:
        studio = Studio("bimanual_table")
        studio.lay_out(0)
        studio.grasp(moment)
        columns.append([studio.picture(camera) for camera in cameras])
        studio.close()
    return sheet(list(zip(*columns, strict=True)))


def looks_picture() -> Image.Image:
    """Two cameras (rows) under the looks of four seeds (columns)."""
    studio, columns = Studio("lift_and_place", randomise_look=1.0), []
    for seed in range(1, 5):
        studio.lay_out(seed)
        columns.append([studio.picture(camera) for camera in ("top", "wrist_left")])
    studio.close()
    return sheet(list(zip(*columns, strict=True)))


PICTURES = {"rig": rig_picture, "tasks": tasks_picture, "pictures": moments_picture, "looks": looks_picture}


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    parser.add_argument("names", nargs="*", help=f"of {', '.join(PICTURES)}; default all")
    options = parser.parse_args()
    for name in options.names or PICTURES:
        path = options.out / f"{name}.png"
        PICTURES[name]().quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=2).save(path, optimize=True)
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
