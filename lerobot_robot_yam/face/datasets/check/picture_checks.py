"""Checks of an episode's pictures by means of thumbnails. Grey levels are 0 black … 255 white."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from lerobot_robot_yam.face.datasets.check.flags import Flag, Kind
from lerobot_robot_yam.face.datasets.check.motion_checks import STILL_S, ArmMotion
from lerobot_robot_yam.face.datasets.dataset_pictures import Thumbnails

SAME_LEVELS = 4  # maximum pixel difference of a repeated picture, levels, caused by video coding
REPEATED_LEVELS = 2  # the same between neighbouring frames, levels
MOVES_RAD = 0.2  # joint motion that a camera has to show, rad
MOVES_IN_A_FRAME_RAD = 0.03  # joint motion between two frames that a camera has to show, rad
# REPEATED_SHARE: fraction of repeated pictures from which a camera is slow; FEWEST_MOVING: minimum of moving frames
REPEATED_SHARE, FEWEST_MOVING = 0.3, 10
BLACK_LEVEL = 16  # level below which 99 % of the pixels of a black picture are
# WHITE_LEVEL: minimum level of a white pixel; WHITE_SHARE: fraction of white pixels from which a picture is white
WHITE_LEVEL, WHITE_SHARE = 250, 0.6
# ALIKE_LEVELS: maximum mean difference between equal views; CONTRAST_LEVELS: minimum contrast for this check
ALIKE_LEVELS, CONTRAST_LEVELS = 2.0, 4.0
SWAPPED_LEVELS = 8.0  # minimum mean difference between a swapped picture and a camera's usual view, levels
FEWEST_EPISODES = 3  # minimum number of episodes from which a camera's usual view is known


def seen_arms(camera: str, arms: Sequence[ArmMotion]) -> list[ArmMotion]:
    """Return the arms that a camera has to show: the arm on the side in the camera's name, otherwise all arms."""
    sides = [arm for arm in arms if arm.prefix and arm.prefix.rstrip("_") in camera.rpartition(".")[2].split("_")]
    return sides if len(sides) == 1 else list(arms)


def exposure(camera: str, thumbnails: Thumbnails) -> Iterator[Flag]:
    """Flag black or white pictures."""
    images = thumbnails.images
    black = np.percentile(images, 99, axis=(1, 2)) < BLACK_LEVEL
    if black.any():
        at = thumbnails.frames[black]
        text = f"{camera}: {black.sum()} of {len(images)} pictures are black"
        yield Flag(Kind.CAMERA_DARK, text, (int(at[0]), int(at[-1])))
    white = (images >= WHITE_LEVEL).mean(axis=(1, 2)) > WHITE_SHARE
    if white.mean() > 0.5:
        text = f"{camera}: {white.sum()} of {len(images)} pictures are mostly white"
        yield Flag(Kind.CAMERA_BRIGHT, text)


def repeated(camera: str, thumbnails: Thumbnails, arms: Sequence[ArmMotion], fps: float) -> Iterator[Flag]:
    """Flag pictures of a camera that stay the same while arms move."""
    frames, images = thumbnails.frames, thumbnails.images.astype(np.int16)
    joints = [arm.state for arm in seen_arms(camera, arms)]
    if len(frames) < 2 or not joints:
        return
    state = np.concatenate(joints, axis=1)
    for start, stop in _stills(images):
        first, last = int(frames[start]), int(frames[stop])
        moved = float(np.ptp(state[first : last + 1], axis=0).max())
        if last - first >= STILL_S * fps and moved > MOVES_RAD:
            text = f"{camera}: the same picture for {(last - first) / fps:.1f} s while a joint moves by {moved:.2f} rad"
            yield Flag(Kind.CAMERA_FROZEN, text, (first, last))
            return
    adjacent = np.diff(frames) == 1
    moving = adjacent & (np.abs(state[frames[1:]] - state[frames[:-1]]).max(axis=1) > MOVES_IN_A_FRAME_RAD)
    same = np.abs(np.diff(images, axis=0)).max(axis=(1, 2)) <= REPEATED_LEVELS
    if moving.sum() >= FEWEST_MOVING and same[moving].mean() > REPEATED_SHARE:
        text = f"{camera}: {same[moving].sum()} of {moving.sum()} pictures of a moving arm repeat the one before"
        yield Flag(Kind.CAMERA_SLOW, text)


def _stills(images: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield (first, last) of each run of pictures that equal the first picture of the run."""
    start = 0
    for place in range(1, len(images) + 1):
        if place == len(images) or np.abs(images[place] - images[start]).max() > SAME_LEVELS:
            yield start, place - 1
            start = place


def alike(pictures: Mapping[str, Thumbnails]) -> Iterator[Flag]:
    """Flag two cameras with the same pictures."""
    for (one, first), (other, second) in combinations(pictures.items(), 2):
        _, left, right = np.intersect1d(first.frames, second.frames, return_indices=True)
        if not len(left):
            continue
        ours, theirs = first.images[left].astype(np.int16), second.images[right].astype(np.int16)
        if ours.std(axis=(1, 2)).mean() > CONTRAST_LEVELS and np.abs(ours - theirs).mean() < ALIKE_LEVELS:
            yield Flag(Kind.CAMERAS_ALIKE, f"{one} and {other} show the same")


def swapped(views: Mapping[int, Mapping[str, np.ndarray]]) -> Iterator[tuple[int, Flag]]:
    """Flag episodes in which two cameras show each other's usual view. Yield (episode number, flag).

    views: episode number → camera → mean picture (HEIGHT, WIDTH).
    """
    for one, other in combinations(sorted({camera for view in views.values() for camera in view}), 2):
        both = {number: (view[one], view[other]) for number, view in views.items() if {one, other} <= view.keys()}
        if len(both) < FEWEST_EPISODES:
            continue
        usual = np.median([pair for pair in both.values()], axis=0)
        for number, pair in both.items():
            own = np.abs(np.array(pair) - usual).mean()
            crossed = np.abs(np.array(pair[::-1]) - usual).mean()
            if own > SWAPPED_LEVELS and crossed < own / 2:
                yield number, Flag(Kind.CAMERAS_SWAPPED, f"{one} and {other} show each other's view")
