"""Render the images in docs/ that show the virtual rig, with its own renderer and in lock-step, so reproducibly.

    scripts/run python scripts/pictures.py --out docs

rig.webp: four arms perform the task of scripts/record_sim, above the images of their cameras. The animation is fully
simulated: the operator's hands pull the leaders, the control loop drives all four arms, and friction holds the cube.
tasks.png: the four tasks. pictures.png: camera images at four moments of a grasp. looks.png: random looks drawn with
`randomise_look`.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.rig.lockstep.lockstep_cameras import LockstepCamera
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.operator.operator import RigHands
from lerobot_robot_yam.rig.operator.script import SIDES, make_setup
from lerobot_robot_yam.rig.operator.task_scripts import make_script
from lerobot_robot_yam.session.arm_session import ArmSession

SIZE = (320, 240)  # size that configs/sim/record.yaml records
TASKS = ("lift_and_place", "handover", "drawer", "insertion")
MOMENTS = ("waiting", "above", "at", "holding")
RISES_M = {"above": 0.1, "at": 0.0, "holding": 0.08}  # height of the tool above the cube's position
CUBE_M, STROKE_M = 0.04, 0.095  # widths of the cube and of the open gripper
GAP = 4  # pixels
TICK_S, FRAME_S = 0.004, 0.09  # period of the control loop, and of the animation's frames
SPEED = 1.6  # playback speed, shown as a label
OVERVIEW, ARMS = (1280, 640), (160, 75, 1160, 575)  # image size, and the section that contains the arms: pixels
SMALL = (216, 162)  # size of a camera image in the animation
FADE = 4  # blended frames from the end to the start, where the cube is elsewhere
STILL = 17  # frame shown where animations are not played: the cube is in the air


class Studio:
    """A rig whose arms and things can be posed for an image. `scene`, `options`: see `load_scene`."""

    def __init__(self, scene: str, **options: object):
        self.rig = LockstepRig(scene, camera_noise=0.0, **options)
        row = self.rig.scene()
        self.task = row["tasks"][0]["name"] if row["tasks"] else None
        self.setup = make_setup(row, self.task or "pick_and_place")
        self._cameras: dict[tuple[str, int, int], LockstepCamera] = {}

    def lay_out(self, seed: int) -> None:
        """Begin a task with the arms in their waiting poses and the grippers open."""
        if self.task:
            self.rig.task(self.task, seed)
        for side in self.setup.planners:
            self.rig.set_pose(f"follower_{side}", self.setup.home_rad(side).tolist(), 1.0)

    def grasp(self, moment: str) -> None:
        """Pose the nearest arm and the cube, which must be aligned with the axes, for a moment of a grasp."""
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

    def picture(self, camera: str, size: tuple[int, int] = SIZE, at_rest: bool = True) -> Image.Image:
        """Return the current image of a camera. at_rest: nothing has moved by itself since the last image."""
        key = (camera, *size)
        if key not in self._cameras:
            self._cameras[key] = LockstepCamera(self.rig, *key, 30)
            self._cameras[key].connect()
        if at_rest:
            self.rig.sleep(0.002)  # otherwise the renderer would reuse the last image
        return Image.fromarray(self._cameras[key].latest()[0])

    def close(self) -> None:
        """End the rig."""
        self.rig.close()


def sheet(rows: Sequence[Sequence[Image.Image]]) -> Image.Image:
    """Return one image with the given rows of images, side by side within each row."""
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


def labelled(picture: Image.Image, text: str) -> Image.Image:
    """Draw a text into the corner of an image; return the image."""
    ImageDraw.Draw(picture).text((6, 3), text, "white", ImageFont.load_default(13), stroke_width=1, stroke_fill="black")
    return picture


class FilmedHands(RigHands):
    """Hands in lock-step on a studio's leaders. While the operator waits, the followers follow and are filmed."""

    def __init__(self, studio: Studio):
        scene = studio.rig.scene()
        super().__init__(studio.rig, scene)
        self._studio, self._next_s = studio, math.inf
        self.frames: list[Image.Image] = []
        self._arms = ArmSession([self._config(row) for row in scene["arms"]], isolation="lockstep")
        self._arms.start()

    def _config(self, row: dict) -> ArmConfig:
        """Return an arm's config as in configs/sim/record.yaml."""
        name, start = row["channel"], "float" if row["role"] == "leader" else "hold"
        weight, bus = [1.0] * 6, {"interface": "yam_lockstep", "can_options": {"rig": self._studio.rig.name}}
        return ArmConfig(name=name, channel=name, gripper=row["gripper"], start=start, gravity_factor=weight, **bus)

    def now(self) -> float:
        return self._studio.rig.now()

    def film(self) -> None:
        """Start filming."""
        self._next_s = self.now()

    def wait(self, seconds: float) -> None:
        until_s = self.now() + seconds
        while self.now() < until_s:
            for side in SIDES:
                leader = self._arms[f"leader_{side}"].newest()
                self._arms[f"follower_{side}"].write_target(leader.q, 1.0 - leader.trigger)
            self._arms.clock.sleep(TICK_S)
            if self.now() >= self._next_s:
                self._next_s += SPEED * FRAME_S
                self.frames.append(self._frame())

    def _frame(self) -> Image.Image:
        """Return the overview above the images of the recorded cameras."""
        cameras = ("top", "wrist_left", "wrist_right")
        small = [self._studio.picture(camera, at_rest=False).resize(SMALL) for camera in cameras]
        width = 3 * SMALL[0] + 2 * GAP
        overview = self._studio.picture("overview", OVERVIEW, at_rest=False).crop(ARMS)
        overview = overview.resize((width, width * overview.height // overview.width), Image.Resampling.LANCZOS)
        return sheet([[labelled(overview, f"{SPEED:g}x")], list(map(labelled, small, cameras))])

    def close(self) -> None:
        """End the control loop."""
        self._arms.discard()


def rig_film() -> list[Image.Image]:
    """Film the left arm carrying the cube to the middle, and the right arm from there to its own side."""
    studio = Studio("bimanual_table")
    hands = FilmedHands(studio)
    operator = make_script(hands, studio.rig.scene(), "pick_and_place")
    operator.begin()
    hands.film()
    for _ in SIDES:
        operator.work()
    for worker in operator.workers.values():
        worker.go_home()
    for worker in operator.workers.values():
        worker.wait()
    hands.close()
    studio.close()
    frames, last = hands.frames, hands.frames[-1]
    frames += [Image.blend(last, frames[0], number / (FADE + 1)) for number in range(1, FADE + 1)]
    return frames[STILL:] + frames[:STILL]


def tasks_picture() -> Image.Image:
    """Return the four tasks, laid out, seen from the front."""
    found = []
    for task in TASKS:
        studio = Studio(task)
        studio.lay_out(1)
        found.append(studio.picture("front", (480, 360)))
        studio.close()
    return sheet([found[:2], found[2:]])


def moments_picture() -> Image.Image:
    """Return camera images (rows) at the moments of a grasp (columns)."""
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
    """Return images of two cameras (rows) with the looks of four seeds (columns)."""
    studio, columns = Studio("lift_and_place", randomise_look=1.0), []
    for seed in range(1, 5):
        studio.lay_out(seed)
        columns.append([studio.picture(camera) for camera in ("top", "wrist_left")])
    studio.close()
    return sheet(list(zip(*columns, strict=True)))


PICTURES = {"rig": rig_film, "tasks": tasks_picture, "pictures": moments_picture, "looks": looks_picture}


def save(drawn: Image.Image | list[Image.Image], path: Path) -> Path:
    """Write an image, or the frames of an endless animation; return the file."""
    if isinstance(drawn, Image.Image):
        path = path.with_suffix(".png")
        drawn.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=2).save(path, optimize=True)
    else:
        path = path.with_suffix(".webp")
        first, *others = drawn
        small = {"quality": 55, "method": 4, "kmin": len(drawn), "kmax": len(drawn) + 1}  # a single key frame
        first.save(path, save_all=True, append_images=others, duration=round(1000 * FRAME_S), loop=0, **small)
    return path


def main() -> int:
    """Render and save the images; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    parser.add_argument("names", nargs="*", help=f"of {', '.join(PICTURES)}; default all")
    options = parser.parse_args()
    for name in options.names or PICTURES:
        print(save(PICTURES[name](), options.out / name))
    return 0


if __name__ == "__main__":
    sys.exit(main())
