"""A name that something else gives, and an adapter that something else names, are refused with the place to look."""

import pytest

from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.setup.adapter_rules import NamedAdapter, check_free

ADAPTER = NamedAdapter("can_left", "00A1", None, "devices/usb1/1-2/1-2:1.0")
RULE = 'SUBSYSTEM=="net", ATTRS{serial}=="%s", NAME="%s"\n'


def write(root, path, text):
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text)


@pytest.mark.parametrize(
    ("path", "text", "message"),
    [
        ("etc/udev/rules.d/70-net.rules", RULE % ("77", "can_left"), "taken by /etc/udev/rules.d/70-net.rules:1: take"),
        ("etc/udev/rules.d/70-net.rules", RULE % ("00A1", "can7"), "can0 is named can7 by /etc/udev/rules.d/70"),
        ("etc/systemd/network/10-a.link", "[Link]\nName=can_left\n", "taken by /etc/systemd/network/10-a.link:2"),
        ("sys/class/net/can_left/address", "", "taken by a network interface: choose another name"),
    ],
)
def test_what_is_taken_is_refused(tmp_path, path, text, message):
    write(tmp_path, path, text)
    with pytest.raises(SetupError, match=message):
        check_free(tmp_path, ADAPTER, "can0", [])


def test_what_is_free_or_our_own_is_not(tmp_path):
    write(tmp_path, "etc/udev/rules.d/70-net.rules", "# " + RULE % ("00A1", "can7") + RULE % ("77", "can9"))
    write(tmp_path, "sys/class/net/can_left/address", "")
    check_free(tmp_path, ADAPTER, "can0", ["can_left"])
    check_free(tmp_path, ADAPTER, "can_left", [])


def test_a_file_that_cannot_be_read_names_nothing(tmp_path):
    write(tmp_path, "etc/udev/rules.d/70-net.rules", "")
    (tmp_path / "etc/udev/rules.d/80-gone.rules").symlink_to("/nowhere")
    check_free(tmp_path, ADAPTER, "can0", [])
