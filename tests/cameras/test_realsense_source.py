"""The path through librealsense, on its software device: streams, options, errors, dropping out and coming back."""

import time

import numpy as np
import pytest

from lerobot_robot_yam.cameras.opening import find_camera, open_camera
from lerobot_robot_yam.cameras.picture_source import Wanted
from lerobot_robot_yam.config_yam_realsense import YamRealsenseCameraConfig
from lerobot_robot_yam.errors import CameraError, ConfigError
from lerobot_robot_yam.yam_realsense import YamRealsenseCamera
from tests.support.software_realsense import (
    ASIC_SERIAL,
    DEFAULT_EXPOSURE,
    FPS,
    HEIGHT,
    MOST_EXPOSURE,
    SERIAL,
    WIDTH,
    Bus,
    SoftwareRealSense,
)

rs = pytest.importorskip(
    "pyrealsense2", reason="pyrealsense2 is not installed, or libusb-1.0 is missing", exc_type=ImportError
)
SIZE = {"width": WIDTH, "height": HEIGHT, "fps": FPS}
SIZE_TURNED = {"width": HEIGHT, "height": WIDTH, "fps": FPS}


@pytest.fixture
def bus(monkeypatch):
    bus = Bus()
    monkeypatch.setattr(rs, "context", bus)
    yield bus
    for camera in bus.plugged:
        camera.close()


@pytest.fixture(params=[False, True], ids=["D405", "D435"])
def camera(bus, request):
    camera = SoftwareRealSense(rs, rgb=request.param)
    bus.plugged.append(camera)
    return camera


def opened(**wanted):
    return open_camera(Wanted(SERIAL, **SIZE, **wanted))


def test_colour_and_depth_in_mm_whatever_the_camera_counts_in(camera):
    source = opened(depth=True)
    picture = source.read()
    source.close()
    assert picture.colour.shape == (HEIGHT, WIDTH, 3) and picture.colour.dtype == np.uint8
    assert picture.depth.shape == (HEIGHT, WIDTH, 1) and picture.depth.dtype == np.uint16
    assert (picture.depth == 250).all()  # 0.25 m; the camera counts in 0.1 mm, as a D405 does
    assert 0.0 <= time.monotonic() - picture.stamp_s < 1.0


def test_exposure_gain_and_white_balance_go_to_the_module_that_gives_colour(camera):
    opened(exposure=2000, gain=32, white_balance=3000).close()
    assert [camera.option(name) for name in ("exposure", "gain", "white_balance")] == [2000, 32, 3000]
    assert camera.option("enable_auto_exposure") == camera.option("enable_auto_white_balance") == 0


def test_what_is_not_asked_for_stays_automatic(camera):
    source = opened()
    assert source.exposure_range() == (1, MOST_EXPOSURE)
    source.close()
    assert camera.option("enable_auto_exposure") == camera.option("enable_auto_white_balance") == 1
    assert camera.option("exposure") == DEFAULT_EXPOSURE


def test_a_camera_can_be_opened_again(camera):
    for _ in range(2):
        source = opened()
        assert source.read().colour is not None
        source.close()
        source.close()


@pytest.mark.parametrize("name", [SERIAL, ASIC_SERIAL, "D405", "Intel RealSense D405"])
def test_both_serial_numbers_and_the_name_find_it(bus, name):
    bus.plugged.append(SoftwareRealSense(rs))
    assert find_camera(name).serial == SERIAL


def test_errors_say_what_there_is(bus):
    bus.plugged.append(SoftwareRealSense(rs))
    with pytest.raises(ConfigError, match=f"does not offer color 640x480 at 30 fps; it offers {WIDTH}x{HEIGHT} at 30"):
        open_camera(Wanted(SERIAL, width=640, height=480, fps=30))
    with pytest.raises(ConfigError, match="exposure 200000 is out of range; it takes 1 to 165000"):
        opened(exposure=200000)
    with pytest.raises(CameraError, match=f"there is no camera 1; there are: D405 {SERIAL}; plug it in"):
        open_camera(Wanted("1"))
    bus.plugged.append(SoftwareRealSense(rs))
    with pytest.raises(CameraError, match="2 cameras have the serial number"):
        opened()


def test_a_camera_that_stalls_says_so(camera):
    source = opened()
    source.read()
    camera.stalls = True
    try:
        with pytest.raises(CameraError, match="gives no picture"):
            for _ in range(5):
                source.read()
    finally:
        source.close()


def test_a_lerobot_camera_drops_out_and_comes_back(bus):
    first = SoftwareRealSense(rs)
    bus.plugged.append(first)
    camera = YamRealsenseCamera(
        YamRealsenseCameraConfig(serial_number_or_name=SERIAL, use_depth=True, rotation=90, warmup_s=0, **SIZE_TURNED)
    )
    camera.connect()
    try:
        assert camera.async_read(1000).shape == (WIDTH, HEIGHT, 3) and (camera.height, camera.width) == (WIDTH, HEIGHT)
        assert camera.async_read_depth(1000).shape == camera.read_latest_depth().shape == (WIDTH, HEIGHT, 1)
        first.stalls = True
        bus.plugged.clear()
        time.sleep(0.3)
        with pytest.raises(TimeoutError, match="old, more than"):
            camera.read_latest(200)
        bus.plugged.append(SoftwareRealSense(rs))
        assert camera.async_read(20_000).shape == camera.read().shape  # the second waits for a newer one
        assert (camera.read_latest_depth() == 250).all()
    finally:
        camera.disconnect()
        first.close()
