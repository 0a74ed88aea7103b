"""The teleoperator yam_base_keys, with a terminal that types."""

import os

import draccus
import pytest
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.teleoperators.config import TeleoperatorConfig

import lerobot_robot_yam  # noqa: F401
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError
from tests.support.waiting import wait


@pytest.fixture
def typing(monkeypatch):
    """Types into the terminal that is standard input here."""
    master, slave = os.openpty()
    with open(slave) as file, open(master, "wb", buffering=0) as typing:
        monkeypatch.setattr("sys.stdin", file)
        yield typing.write


def made(**options):
    return make_teleoperator_from_config(draccus.decode(TeleoperatorConfig, {"type": "yam_base_keys", **options}))


def test_a_held_key_drives_and_letting_go_brakes(typing):
    device = made(rail=True, hold_s=0.7)
    device.connect()
    try:
        assert list(device.get_action()) == list(device.action_features) == [
            "x.vel", "y.vel", "theta.vel", "height.vel"
        ]  # fmt: skip
        typing(b"u")
        wait(lambda: device.get_action()["theta.vel"] == pytest.approx(27.0))
        typing(b"vu")
        wait(lambda: device.get_action()["theta.vel"] == pytest.approx(90.0))
        wait(lambda: not any(device.get_action().values()))
    finally:
        device.disconnect()


def test_without_a_terminal_it_is_refused(monkeypatch):
    monkeypatch.setattr("sys.stdin", open(os.devnull))
    device = made()
    with pytest.raises(ConfigError, match="no terminal to type into"):
        device.connect()
    assert not device.is_connected


def test_options_that_are_refused():
    with pytest.raises(RefusedConfigError, match="yam_base_keys: hold_s is 0.1 to 0.7 s"):
        made(hold_s=1.0)
