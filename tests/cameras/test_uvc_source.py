"""The path through OpenCV: a stream that OpenCV really opens and decodes, in a tree laid out as sysfs and /dev are."""

import os
import re
import subprocess
import sys
import tempfile
import time

import numpy as np
import pytest

from lerobot_robot_yam.cameras.opening import find_camera, open_camera
from lerobot_robot_yam.cameras.picture_source import Wanted
from lerobot_robot_yam.config_yam_realsense import YamRealsenseCameraConfig
from lerobot_robot_yam.errors import CameraError, ConfigError, StaleStateError
from lerobot_robot_yam.yam_realsense import YamRealsenseCamera
from tests.support.plugged_cameras import FPS, HEIGHT, READ_AT_ONCE, SERIAL, WIDTH, FedCamera, Tree

NOBODY = 65534


@pytest.fixture
def tree(tmp_path):
    return Tree(tmp_path / "computer")


@pytest.fixture
def fed(tree, monkeypatch):
    for name, value in READ_AT_ONCE.items():
        monkeypatch.setenv(name, value)
    camera = FedCamera(tree)
    camera.plug_in()
    yield camera
    camera.pull_out()


@pytest.fixture
def camera(fed):
    """The LeRobot camera, connected."""
    config = YamRealsenseCameraConfig(
        serial_number_or_name=SERIAL, width=WIDTH, height=HEIGHT, fps=FPS, warmup_s=0, root=str(fed.tree.root)
    )
    camera = YamRealsenseCamera(config)
    camera.connect()
    yield camera
    fed.stalls = False  # a reader of a pipe waits for ever, and nobody could end it
    camera.disconnect()


def number_of(image):
    """Of the picture, as FedCamera paints it; JPEG may lose a bit."""
    return image[..., 0].mean() / 2


def test_pictures_are_rgb_and_each_is_newer_than_the_one_before(camera, fed):
    images = [camera.async_read(2000) for _ in range(4)] + [camera.read()]
    assert all(image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.uint8 for image in images)
    assert abs(images[0][0, 0].astype(int) - [2 * number_of(images[0]), 90, 40]).max() < 6
    assert (np.diff([number_of(image) for image in images]) > 0.4).all()
    assert fed.number - number_of(camera.read_latest()) < 4


def test_a_stall_is_no_fresh_picture_and_ends_by_itself(camera, fed):
    camera.async_read(2000)
    fed.stalls = True
    time.sleep(0.4)
    with pytest.raises(StaleStateError, match="newest picture is .* ms old, more than 200 ms; the camera, its USB bus"):
        camera.read_latest(200)
    with pytest.raises(TimeoutError, match="no new picture within 50 ms"):
        for _ in range(2):  # one may have come that nobody has seen
            camera.async_read(50)
    stalled = fed.number
    fed.stalls = False
    assert number_of(camera.read()) > stalled - 1


def test_a_camera_that_comes_back_under_another_number_goes_on(camera, fed):
    camera.async_read(2000)
    fed.pull_out()
    time.sleep(0.3)
    with pytest.raises(StaleStateError, match=f"there is no camera {SERIAL}; there are: none; plug it in"):
        camera.read_latest(200)
    gone = fed.number
    fed.plug_in("video6", "1-4")
    assert number_of(camera.async_read(20_000)) > gone - 1


def test_sizes_that_it_does_not_give(fed):
    with pytest.raises(ConfigError, match=rf"gives {WIDTH}x{HEIGHT}, not 640x480: set width and height"):
        open_camera(Wanted(SERIAL, 640, 480, 30), fed.tree.root)


@pytest.mark.parametrize(
    "wanted, words",
    [
        (Wanted(SERIAL, depth=True), "depth takes librealsense: set use_depth to false, or install it"),
        (Wanted(SERIAL, exposure=100), "offers no exposure over UVC: leave exposure out"),
        (Wanted(SERIAL, white_balance=4000), "offers no white_balance over UVC"),
    ],
)
def test_what_takes_librealsense(fed, wanted, words):
    with pytest.raises((CameraError, ConfigError), match=words):
        open_camera(wanted, fed.tree.root)


def test_no_such_serial_number(tree):
    tree.realsense("video0", "2-1")
    tree.webcam("video2", "1-3")
    there = rf"there are: D405 {SERIAL} \(USB 2-1\), Webcam C270 200901010001 \(USB 1-3\); plug it in, or correct"
    with pytest.raises(CameraError, match=f"there is no camera 1; {there}"):
        find_camera("1", tree.root)
    assert find_camera("D405", tree.root).serial == SERIAL


def test_two_cameras_with_one_serial_number_or_of_one_model(tree):
    tree.webcam("video0", "1-3")
    tree.webcam("video2", "1-4")
    with pytest.raises(CameraError, match=r"2 cameras have the serial number .* \(USB 1-3\), .* \(USB 1-4\); unplug"):
        find_camera("200901010001", tree.root)
    tree.realsense("video4", "2-1", serial="1")
    tree.realsense("video6", "2-2", serial="2")
    with pytest.raises(CameraError, match=r"there are 2 of D405: .*; give the serial number of one"):
        find_camera("D405", tree.root)


def test_a_camera_without_a_node(tree):
    tree.sysfs.usb("2-1", speed="5000", vendor="8086", product="Intel(R) RealSense(TM) Depth Camera 405", serial="7")
    with pytest.raises(CameraError, match="no video node: another program may read it"):
        open_camera(Wanted("7"), tree.root)


def test_a_camera_in_use_names_the_process(tree):
    tree.realsense("video0", "2-1")
    node = tree.root / "dev/video0"
    code = "import sys, time; held = open(sys.argv[1]); print('holds', flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code, str(node)], stdout=subprocess.PIPE, text=True) as holder:
        try:
            assert holder.stdout.readline() == "holds\n"
            name = re.escape(open(f"/proc/{holder.pid}/comm").read().strip())
            with pytest.raises(
                CameraError, match=rf"cannot be opened: process {holder.pid} \({name}\) has it open: end"
            ):
                open_camera(Wanted(SERIAL), tree.root)
        finally:
            holder.kill()
    with pytest.raises(CameraError, match="cannot be opened: no process of yours has it open"):
        open_camera(Wanted(SERIAL), tree.root)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become a user without rights")
def test_no_rights_name_the_group(tree):
    tree.realsense("video0", "2-1")
    node = tree.root / "dev/video0"
    for group, words in ((44, "join the group video"), (0, r"yam-setup-can.* --rights` gives it to the group video")):
        os.chown(node, 0, group)
        node.chmod(0o660)
        for parent in node.parents:
            if parent.owner() == "root" and str(parent).startswith(f"{tempfile.gettempdir()}/"):
                parent.chmod(0o755)
        os.setegid(NOBODY)
        os.seteuid(NOBODY)
        try:
            with pytest.raises(CameraError, match=f"no right to open {node}: .*{words}.*, then log in again"):
                open_camera(Wanted(SERIAL), tree.root)
        finally:
            os.seteuid(0)
            os.setegid(0)


def test_a_command_is_refused_before_anything_is_opened(tree, monkeypatch):
    tree.webcam("video0", "1-3")
    monkeypatch.setattr(sys, "argv", ["lerobot-record"])
    with pytest.raises(ConfigError, match=f"there is no camera {SERIAL}; there are: Webcam C270"):
        YamRealsenseCameraConfig(serial_number_or_name=SERIAL, root=str(tree.root))
    with pytest.raises(ConfigError, match="depth takes librealsense"):
        YamRealsenseCameraConfig(serial_number_or_name="200901010001", use_depth=True, root=str(tree.root))
    YamRealsenseCameraConfig(serial_number_or_name="200901010001", root=str(tree.root))
