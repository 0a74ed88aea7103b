"""The check finds each defect that is seeded in pictures, in its episode and nowhere else."""

import shutil

import pytest

from lerobot_robot_yam.face.datasets.check.flags import Kind
from tests.support import seeded_sets as seeds
from tests.support.seeded_sets import EPISODES, FRAMES, SICK, edit_metadata, found, repaint


def during(episode, frames, image):
    """A painter that shows something else in some frames of an episode."""
    return lambda e, f, seen: image(seen) if e == episode and f in frames else seen


def freeze(root, first=10, end=45):
    still = seeds.picture("top", seeds.motion(SICK)[1][10])
    repaint(root, "top", during(SICK, range(first, end), lambda seen: still))


def swap_pictures(root):
    views = {c: [seeds.picture(c, state) for state in seeds.motion(SICK)[1]] for c in ("top", "left_wrist")}
    for one, other in (("top", "left_wrist"), ("left_wrist", "top")):
        repaint(root, one, lambda e, f, seen, other=other: views[other][f] if e == SICK else seen)


def no_clip(root):
    edit_metadata(root, lambda rows: rows[SICK].update({"videos/observation.images.top/file_index": None}))


IN_PICTURES = {
    Kind.CAMERA_FROZEN: freeze,
    Kind.CAMERA_DARK: lambda root: repaint(root, "left_wrist", during(SICK, range(FRAMES), lambda seen: 0 * seen)),
    Kind.CAMERA_BRIGHT: lambda root: repaint(root, "top", during(SICK, range(FRAMES), lambda seen: 0 * seen + 255)),
    Kind.CAMERAS_SWAPPED: swap_pictures,
    Kind.VIDEO_MISSING: no_clip,
}


@pytest.mark.parametrize(("kind", "seed"), IN_PICTURES.items(), ids=map(str, IN_PICTURES))
def test_a_defect_of_pictures_is_found_there_and_only_there(kind, seed, data):
    seed(data)
    files, episodes = found(data)
    assert not files and episodes.keys() == {SICK} and kind in episodes[SICK]
    assert episodes[SICK] <= {kind} | (
        {Kind.CAMERA_FROZEN} if kind in (Kind.CAMERA_DARK, Kind.CAMERA_BRIGHT) else set()
    )


def test_a_short_freeze_and_a_black_picture_are_found_where_all_pictures_are_looked_at(data):
    freeze(data, 10, 22)
    repaint(data, "right_wrist", during(SICK, [33], lambda seen: 0 * seen))
    assert found(data)[1] == {}
    assert found(data, every_s=0)[1] == {SICK: {Kind.CAMERA_FROZEN, Kind.CAMERA_DARK}}


def test_a_camera_at_half_the_rate(data):
    states = [seeds.motion(episode)[1] for episode in range(EPISODES)]
    repaint(data, "top", lambda e, f, seen: seeds.picture("top", states[e][f - f % 2]))
    assert found(data, every_s=0)[1] == {episode: {Kind.CAMERA_SLOW} for episode in range(EPISODES)}


def test_two_cameras_that_are_one(data):
    shutil.copy(seeds.video(data, "top"), seeds.video(data, "left_wrist"))
    assert found(data)[1] == {episode: {Kind.CAMERAS_ALIKE} for episode in range(EPISODES)}


def test_a_video_without_its_last_frames(data):
    repaint(data, "top", lambda e, f, seen: None if e == EPISODES - 1 and f > 50 else seen)
    assert found(data)[1] == {EPISODES - 1: {Kind.VIDEO_SHORT}}


def test_videos_that_are_gone_or_broken(data):
    seeds.video(data, "top").unlink()
    path = seeds.video(data, "left_wrist")
    content = path.read_bytes()
    begin = content.index(b"mdat") + 4
    path.write_bytes(content[:begin] + bytes(len(content) - begin))
    for kinds in (found(data)[1], found(data, every_s=0)[1]):
        assert kinds == {episode: {Kind.VIDEO_MISSING, Kind.VIDEO_BROKEN} for episode in range(EPISODES)}
