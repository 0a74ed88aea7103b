"""The teleoperator yam_gamepad, with pads that SDL simulates."""

import logging
from functools import partial

import draccus
import pytest
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.teleoperators.config import TeleoperatorConfig

import lerobot_robot_yam  # noqa: F401
from lerobot_robot_yam.errors import ConfigError, LifeCycleError
from lerobot_robot_yam.face.driving.pad_map import AxisUse, PadMap
from lerobot_robot_yam.face.driving.sdl_pads import open_pad
from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError
from lerobot_robot_yam.face.operator_keys import requests
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_teleoperator_yam import yam_gamepad
from lerobot_teleoperator_yam.yam_gamepad import map_path
from tests.support.virtual_pad import VirtualPad
from tests.support.waiting import wait

STILL = {"x.vel": 0.0, "y.vel": 0.0, "theta.vel": 0.0}


@pytest.fixture
def pad():
    pad = VirtualPad()
    yield pad
    pad.unplug()


@pytest.fixture
def made(tmp_path):
    """Makes the teleoperator as LeRobot does; it is disconnected in the end."""
    devices = []

    def make(**options):
        config = {"type": "yam_gamepad", "calibration_dir": str(tmp_path), "expo": 0.0, **options}
        devices.append(make_teleoperator_from_config(draccus.decode(TeleoperatorConfig, config)))
        return devices[-1]

    yield make
    for device in devices:
        device.disconnect()


@pytest.fixture
def stop():
    stop = EmergencyStop()
    yield stop
    stop.release()


def test_sticks_drive(pad, made):
    device = made(rail=True)
    device.connect()
    assert list(device.action_features) == ["x.vel", "y.vel", "theta.vel", "height.vel"] == list(device.get_action())
    pad.push("lefty", -1.0)
    pad.push("leftx", -0.525)
    pad.push("rightx", 1.0)
    pad.push("righty", -0.575)
    expected = {"x.vel": 0.5, "y.vel": 0.25, "theta.vel": -90.0, "height.vel": 0.25}
    assert device.get_action() == pytest.approx(expected, abs=1e-3)
    pad.press("leftshoulder")
    assert device.get_action() == pytest.approx({key: 0.3 * value for key, value in expected.items()}, abs=1e-3)


def test_a_pushed_stick_refuses_the_start(pad, made):
    device = made()
    pad.push("leftx", 0.4)
    with pytest.raises(LifeCycleError, match=r"stick of y \(axis 0 of Test Pad\) is off its rest, at -0.37"):
        device.connect()
    assert not device.is_connected
    pad.push("leftx", 0.04)
    device.connect()


def test_an_unplugged_pad_brakes_says_so_and_comes_back(pad, made, caplog):
    caplog.set_level(logging.INFO)
    device = made()
    device.connect()
    pad.push("lefty", -1.0)
    assert device.get_action()["x.vel"] == pytest.approx(0.5)
    pad.unplug()
    assert [device.get_action() for _ in range(3)] == [STILL] * 3 and device.is_connected
    errors = [record.message for record in caplog.records if record.levelno >= logging.ERROR]
    assert len(errors) == 1 and "Test Pad is unplugged, or out of reach; the base brakes" in errors[0]
    again = VirtualPad()
    try:
        again.push("lefty", -1.0)
        wait(lambda: "the gamepad Test Pad is back" in caplog.text)
        assert device.get_action() == STILL  # not before the stick was at rest
        again.push("lefty", 0.0)
        device.get_action()
        again.push("lefty", -1.0)
        assert device.get_action()["x.vel"] == pytest.approx(0.5)
    finally:
        again.unplug()


def test_the_emergency_stop_acts_while_nobody_asks_for_actions(pad, made, stop):
    device = made()
    device.connect()
    pad.press("b")
    wait(lambda: stop.latched)
    assert "button of the gamepad Test Pad" in stop.reason()
    pad.press("b", False)
    pad.push("lefty", -1.0)
    assert device.get_action() == STILL
    pad.press("b")
    device.get_action()
    assert stop.latched  # the pad does not release it


def test_a_stop_that_was_released_between_two_actions_brakes_until_the_sticks_are_at_rest(pad, made, stop, caplog):
    """LeRobot asks for no action while it saves an episode."""
    device = made()
    device.connect()
    pad.push("lefty", -1.0)
    assert device.get_action()["x.vel"] == pytest.approx(0.5)
    stop.latch("somebody shouted")
    pad.press("rightshoulder")  # what the thread says of it shows that it has looked at the stop
    wait(lambda: "there is no policy to take over from" in caplog.text)
    stop.release()
    assert [device.get_action() for _ in range(3)] == [STILL] * 3
    assert "the emergency stop was latched; the base brakes" in caplog.text
    pad.push("lefty", 0.0)
    device.get_action()
    pad.push("lefty", -1.0)
    assert device.get_action()["x.vel"] == pytest.approx(0.5)


def test_a_stop_button_that_is_down_at_the_start_has_to_be_pressed_anew(pad, made, stop):
    pad.press("b")
    made().connect()
    assert not stop.latched
    pad.press("b", False)
    pad.press("b")


class Policy:
    """A command that is asked to take over and to go on."""

    def __init__(self):
        self.asked = []

    def ask(self, press):
        self.asked.append((press.meaning.value, press.by))

    def offers(self, now, first):
        return {}


def test_the_override_button_takes_over_while_it_is_held(pad, made, caplog):
    device, policy = made(), Policy()
    device.connect()
    requests.join(policy, first=True)
    try:
        pad.press("rightshoulder")
        wait(lambda: policy.asked == [("correct", "override of Test Pad")])
        pad.press("rightshoulder", False)
        wait(lambda: policy.asked[1:] == [("go_on", "override of Test Pad")])
    finally:
        requests.leave(policy)
    pad.press("rightshoulder")
    wait(lambda: "there is no policy to take over from" in caplog.text)


def test_a_stored_map_is_used(pad, made, tmp_path):
    opened = open_pad("yam_gamepad", None)
    axes = {name: AxisUse(number, 0.0, 1.0, -1.0) for number, name in enumerate(("theta", "x", "y"))}
    PadMap(axes, {"stop": 0}).save(opened, map_path(opened, tmp_path))
    opened.close()
    device = made()
    device.connect()
    pad.push("leftx", 1.0)
    pad.push("rightx", -1.0)
    assert device.get_action() == pytest.approx({"x.vel": 0.0, "y.vel": -0.5, "theta.vel": 90.0}, abs=1e-3)


def test_an_unknown_pad_has_to_be_calibrated_first(made):
    pad = VirtualPad("Strange Pad", known=False)
    try:
        device = made()
        with pytest.raises(ConfigError, match="Strange Pad: SDL does not know .* lerobot-calibrate"):
            device.connect()
        assert not device.is_connected
        device.connect(calibrate=False)  # as lerobot-calibrate does
        assert device.is_connected
    finally:
        pad.unplug()


class HandledPad:
    """A pad that SDL reads; before each reading a person does the next step of what was asked last."""

    STEPS = {
        "drive forward": ("push", 1, 1.0),  # upside down
        "drive backward": ("push", 1, -1.0),
        "drive to the left": ("push", 0, -1.0),
        "drive to the right": ("push", 0, 1.0),
        "to the left in place": ("push", 3, -1.0),
        "to the right in place": ("push", 3, 0.8),
        "emergency stop": ("press", 5, True),
        "switches": ("press", 4, True),
        "resets": ("press", 3, True),
        "makes the base slow": ("press", 2, True),
        "takes over": ("press", 5, True),
    }

    def __init__(self, real, pad):
        self._real, self._pad, self._coming = real, pad, []
        self.name, self.guid, self.known, self.close = pad.name, pad.guid, pad.known, pad.close

    def emit(self, record):
        for words, (verb, number, value) in self.STEPS.items():
            if words in record.getMessage():
                act = getattr(self._real, verb)
                self._coming += [bool, partial(act, number, value), bool, partial(act, number, 0)]  # bool: nothing

    def read(self):
        if self._coming:
            self._coming.pop(0)()
        return self._pad.read()


def test_a_calibration_is_asked_for_stored_and_used(made, monkeypatch, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    real = VirtualPad("Strange Pad", known=False)
    try:
        person = HandledPad(real, open_pad("yam_gamepad", None))
        monkeypatch.setattr(caplog.handler, "emit", person.emit)
        device = made()
        device.connect(calibrate=False)
        with monkeypatch.context() as patch:
            patch.setattr(yam_gamepad, "open_pad", lambda device, wanted: person)
            device.calibrate()
        device.disconnect()
        assert list(tmp_path.glob("yam/*_pad.json")) == [map_path(person, tmp_path)]
        device.connect()
        real.push(1, 0.525)
        real.push(3, 0.8)
        assert device.get_action() == pytest.approx({"x.vel": 0.25, "y.vel": 0.0, "theta.vel": -90.0}, abs=1e-2)
    finally:
        real.unplug()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"speed": [0.5, 0.5]}, "speed is three numbers"),
        ({"speed": [1.1, 0.5, 90.0]}, "speed is three numbers above 0, at most 1, 1 m/s and 180 deg/s"),
        ({"speed": [0.5, float("nan"), 90.0]}, "speed is three numbers"),
        ({"rail_speed": 0.0}, "rail_speed"),
        ({"slow_factor": 1.5}, "slow_factor"),
        ({"dead_zone": 0.6}, "dead_zone is 0 to 0.5"),
        ({"rail_dead_zone": -0.1}, "rail_dead_zone"),
        ({"expo": 2.0}, "expo is 0 to 1"),
        ({"pad": ""}, "pad is empty"),
    ],
    ids=str,
)
def test_options_that_are_refused(options, why):
    with pytest.raises(RefusedConfigError, match=f"yam_gamepad: {why}"):
        draccus.decode(TeleoperatorConfig, {"type": "yam_gamepad", **options})
