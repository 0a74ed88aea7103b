"""The drivers of switches and brake: the USB converter on a pseudo-terminal, the pins with gpiozero's own mock."""

import contextlib
import os
import time

import gpiozero
import pytest
from gpiozero.pins.mock import MockFactory, MockPin

from lerobot_robot_yam.control.mobile.rail_boards import open_board
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.rail_config import RailConfig
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.system.boards.awaited_board import AwaitedBoard
from tests.mobile.converter import Converter
from tests.support.waiting import wait


def opened(**fields):
    return open_board(ResolvedBase(BaseConfig(channel="can_base", rail=RailConfig(**fields))))


@pytest.fixture
def converter():
    with contextlib.closing(Converter()) as converter:
        yield converter


@pytest.fixture
def usb(converter):
    with contextlib.closing(opened(io="usb_gpio", port=converter.port)) as driver:
        wait(lambda: driver.read().brake_on is True)
        yield driver


def test_the_converter_is_read_and_its_brake_is_engaged_at_once(converter, usb):
    assert converter.outputs == {3: 0}
    assert usb.read()[:3] == (False, False, True)
    converter.inputs[1] = 1
    wait(lambda: usb.read()[:2] == (True, False))
    converter.inputs = {1: 0, 2: 1}
    wait(lambda: usb.read()[:2] == (False, True))
    assert time.monotonic() - usb.read().stamp_s < 1.0
    usb.set_brake(False)
    wait(lambda: usb.read().brake_on is False)
    assert converter.outputs == {3: 1}
    assert {request for request in converter.asked} == {b"\x3a\x03\x00", b"\x3a\x03\x01", b"\x5b\x01\x02\x00"}


def test_one_lost_answer_is_asked_again(converter, usb):
    converter.mutes = 1
    usb.set_brake(False)
    wait(lambda: usb.read().brake_on is False)


def test_a_deaf_converter_shows_in_the_age_and_comes_back(converter, usb):
    converter.deaf = True
    time.sleep(0.2)
    old = usb.read()
    time.sleep(0.1)
    assert usb.read() is old  # nothing is made up
    usb.set_brake(False)
    converter.deaf = False
    wait(lambda: usb.read().brake_on is False)


def test_a_converter_that_restarts_is_told_anew_what_the_brake_shall_do(converter, usb):
    usb.set_brake(False)
    wait(lambda: usb.read().brake_on is False)
    converter.deaf = True  # the frame of the start must not meet an answer
    time.sleep(0.1)
    converter.restart()
    time.sleep(0.1)
    converter.deaf = False
    wait(lambda: converter.outputs == {3: 1})


@pytest.mark.parametrize("_", range(3))  # the driver could begin its next reading before the port is gone
def test_a_converter_that_is_unplugged_between_two_readings_comes_back(tmp_path, converter, _):
    port = tmp_path / "rail"
    port.symlink_to(converter.port)
    with contextlib.closing(opened(io="usb_gpio", port=str(port))) as driver:
        driver.set_brake(False)
        wait(lambda: driver.read().brake_on is False)
        converter.leaving = True
        wait(lambda: not os.path.exists(port))
        driver.set_brake(True)
        with contextlib.closing(Converter()) as again:
            port.unlink()
            port.symlink_to(again.port)
            wait(lambda: driver.read().brake_on is True)
            assert again.outputs == {3: 0}


def test_the_brake_is_set_before_the_end(converter, usb):
    usb.set_brake(False)
    wait(lambda: usb.read().brake_on is False)
    usb.set_brake(True)
    usb.close()
    assert converter.outputs == {3: 0}


def test_a_port_that_is_none_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"base: rail: /dev/none cannot be opened: .*group dialout"):
        opened(io="usb_gpio", port="/dev/none")


@pytest.fixture
def pins():
    """gpiozero's pins of no hardware."""
    before, gpiozero.Device.pin_factory = gpiozero.Device.pin_factory, MockFactory()
    yield gpiozero.Device.pin_factory
    gpiozero.Device.pin_factory.reset()
    gpiozero.Device.pin_factory = before


def test_pins(pins):
    with contextlib.closing(opened(io="gpio")) as driver:
        upper, lower, brake = map(pins.pin, (5, 6, 12))
        assert upper.pull == lower.pull == "up" and brake.function == "output" and brake.state == 0
        assert driver.read()[:3] == (True, True, True)  # open wires
        upper.drive_low()
        lower.drive_low()
        assert driver.read()[:3] == (False, False, True)
        upper.drive_high()
        driver.set_brake(False)
        assert driver.read()[:3] == (True, False, False) and brake.state == 1
        assert time.monotonic() - driver.read().stamp_s < 1.0
        with pytest.raises(ConfigError, match=r"pins \[5, 6, 12\] cannot be opened: .*in use"):
            opened(io="gpio")


class LineError(Exception):
    """An error as lgpio has it: it derives from nothing but Exception."""


def test_pins_that_fail_later_show_in_the_age_of_the_sample(pins, monkeypatch, caplog):
    with contextlib.closing(opened(io="gpio")) as driver:
        before = driver.read()

        def fail(*_):
            raise LineError("line is gone")

        with monkeypatch.context() as broken:
            broken.setattr(MockPin, "_get_state", fail)
            broken.setattr(MockPin, "_set_state", fail)
            broken.setattr(MockPin, "state", property(fail, fail))
            driver.set_brake(False)
            assert driver.read() == driver.read() == before
        assert caplog.text.count("rail: pins cannot be set: line is gone") == 1
        driver.set_brake(False)
        assert driver.read().brake_on is False and driver.read().stamp_s > before.stamp_s


class BusyPin(MockPin):
    """A pin, the brake's of which another process holds at first."""

    busy = True

    def __init__(self, factory, info):
        if self.busy and info.name == "GPIO12":
            raise LineError("GPIO busy")
        super().__init__(factory, info)


def test_pins_that_a_dying_process_holds_are_refused_or_awaited(pins, monkeypatch, caplog):
    pins.pin_class = BusyPin
    with pytest.raises(ConfigError, match=r"pins \[5, 6, 12\] cannot be opened: GPIO busy"):
        opened(io="gpio")
    with contextlib.closing(AwaitedBoard("rail", lambda: opened(io="gpio"))) as driver:
        wait(lambda: "the motor holds until its brake can be engaged" in caplog.text)
        assert driver.read().brake_on is None
        monkeypatch.setattr(BusyPin, "busy", False)
        wait(lambda: driver.read().brake_on is True)
        assert pins.pin(12).function == "output" and pins.pin(12).state == 0


@pytest.mark.parametrize(
    "fields, why",
    [
        ({"io": "serial"}, "io is one of gpio, usb_gpio, sim, not 'serial'"),
        ({"io": "usb_gpio"}, "give port"),
        ({"io": "gpio", "port": "/dev/ttyUSB0"}, "give port"),
        ({"direction": 0}, "direction is 1 or -1"),
        ({"stroke_m": float("nan")}, "stroke_m is 0.04 to 5, not nan"),
        ({"velocity_limit": 1.5}, "velocity_limit is 0.001 to 1, not 1.5"),
        ({"top_speed": 0.0}, "top_speed is 0.05 to 1"),
        ({"pins": [5, 5, 12]}, "pins are three numbers"),
    ],
)
def test_configurations_that_are_none(fields, why):
    with pytest.raises(ConfigError, match=f"rail: {why}"):
        RailConfig(**fields)


def test_a_configuration_travels_as_json():
    config = BaseConfig(channel="can_base", rail={"io": "gpio", "stroke_m": 0.8})
    assert config.rail == RailConfig(stroke_m=0.8)
    with pytest.raises(ConfigError, match="base: rail: unknown keys .*'hight'"):
        BaseConfig(channel="can_base", rail={"hight": 1.0})


def test_the_share_of_speed_falls_with_height():
    share = RailConfig(full_speed_below_m=0.3, top_speed=0.3).driving_share
    assert [share(height) for height in (0.0, 0.3, 0.65, 1.0, float("nan"))] == pytest.approx([1, 1, 0.65, 0.3, 0.3])
