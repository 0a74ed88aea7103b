"""Addresses of hosts, and what their arms are called here."""

import socket

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.remote import host_address
from lerobot_robot_yam.remote.host_address import PORT, HostAddress, machine_name


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [("192.168.1.20", "192.168.1.20", PORT), ("pi-4.local:6000", "pi-4.local", 6000), ("localhost:1", "localhost", 1)],
)
def test_addresses(text, host, port):
    assert HostAddress.of(text) == HostAddress(host, port)


@pytest.mark.parametrize("text", ["", ":5570", "pi:", "pi:0", "pi:65535", "pi:x", "a b", "pi/../x", "-", "::1", "pi:٣"])
def test_what_is_no_address_is_refused(text):
    with pytest.raises(ConfigError, match="host "):
        HostAddress.of(text)


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("localhost", True), ("127.1.2.3", True), ("0.0.0.0", False), ("192.168.1.20", False)],
)
def test_only_this_computer_reaches_the_loopback(host, loopback):
    assert HostAddress(host).is_loopback is loopback


def test_a_channel_has_another_name_here():
    address = HostAddress("pi", 6000)
    assert address.channel("can_follower_l") == "pi:6000/can_follower_l"
    assert address.key("can_follower_l") == "remote.pi-6000-can_follower_l"


def test_computers_of_one_image_have_different_names(tmp_path, monkeypatch):
    """Name, user and runtime directory are the same there; each start draws another boot id."""
    names = []
    for boot in ("6f1c", "6f1c", "93ab"):
        (tmp_path / "boot_id").write_text(f"{boot}\n")
        monkeypatch.setattr(host_address, "_BOOT_ID", tmp_path / "boot_id")
        names.append(machine_name())
    assert names[0] == names[1] != names[2]
    (tmp_path / "boot_id").unlink()
    with pytest.raises(ConfigError, match="is /proc mounted"):
        machine_name()


def test_another_runtime_directory_has_another_number(tmp_path, monkeypatch):
    """A container with its host's network has its name, users and paths, but a directory of its own."""
    directory = tmp_path / "run"
    monkeypatch.setenv("YAM_RUNTIME_DIR", str(directory))
    here = machine_name()
    monkeypatch.setattr(socket, "gethostname", lambda: "a container that shares the directory")
    assert machine_name() == here
    directory.rename(tmp_path / "of-the-host")
    assert machine_name() != here
