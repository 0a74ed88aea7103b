"""A RealSense that stalls, is pulled out, and comes back in the middle of lerobot-record."""

import contextlib
import time

import pytest
from lerobot.datasets import LeRobotDataset

from tests.cli.conftest import one_episode, options, virtual
from tests.support.plugged_cameras import FPS, HEIGHT, READ_AT_ONCE, SERIAL, WIDTH, FedCamera, Tree

pytestmark = pytest.mark.alone

SECONDS = 3
DROP_S = 0.3
CAMERA = f"{{type: yam_realsense, serial_number_or_name: '{SERIAL}', width: {WIDTH}, height: {HEIGHT}, fps: {FPS}, "


@pytest.fixture
def camera(tmp_path, monkeypatch):
    for name, value in READ_AT_ONCE.items():
        monkeypatch.setenv(name, value)
    camera = FedCamera(Tree(tmp_path / "computer"))
    camera.plug_in()
    yield camera
    camera.pull_out()


@contextlib.contextmanager
def recording(commands, camera):
    """lerobot-record of one arm that sees the camera, once it records."""
    root = commands.directory / "data"
    process = commands.start(
        "lerobot-record",
        *options(
            robot=virtual("follower", "follower_left", rate_hz=100),
            teleop=virtual("leader", "leader_left", rate_hz=100),
            dataset=one_episode("dropout", root, SECONDS, fps=FPS, video="false"),
        ),
        "--play_sounds=false",
        f"--robot.cameras={{top: {CAMERA}root: {camera.tree.root}}}}}",
    )
    commands.wait(lambda: "Recording episode 0" in commands.output(), process, 90.0)
    time.sleep(1.0)
    yield process
    commands.assert_landed()


@pytest.mark.long
def test_a_camera_that_comes_back_in_time_is_recorded_on(commands, camera):
    with recording(commands, camera) as process:
        camera.pull_out()
        time.sleep(DROP_S)
        camera.plug_in("video4")
        assert commands.finish(process) == 0, commands.output()[-4000:]
    assert "unplugged" in commands.output() and "is back after" in commands.output()
    data = LeRobotDataset("local/dropout", root=commands.directory / "data")
    assert len(data) > 0.5 * SECONDS * FPS
    seen = [round(float(data[i]["observation.images.top"][0].mean()) * 255 / 2) for i in range(len(data))]
    assert all((after - before) % 128 < 64 for before, after in zip(seen, seen[1:], strict=False)), "an older picture"


@pytest.mark.long
@pytest.mark.parametrize("what, words", [("stalls", "old, more than"), ("is pulled out", f"no camera {SERIAL}")])
def test_a_camera_that_stays_away_ends_the_recording(commands, camera, what, words):
    with recording(commands, camera) as process:
        if what == "stalls":
            camera.stalls = True
        else:
            camera.pull_out()
        assert commands.finish(process) == 1, commands.output()[-4000:]
    last = commands.output().rpartition("\nerror: ")[2]
    assert "camera top has no image" in last and words in last and "Traceback" not in commands.output()
