"""Names that are free; what is refused, tests/commands/test_setup_can.py shows."""

from lerobot_robot_yam.setup.adapter_rules import NamedAdapter, check_free

ADAPTER = NamedAdapter("can_left", "00A1", None, "devices/usb1/1-2/1-2:1.0")
RULE = 'SUBSYSTEM=="net", ATTRS{serial}=="%s", NAME="%s"\n'


def write(root, path, text):
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text)


def test_what_is_free_or_our_own_is_not(tmp_path):
    write(tmp_path, "etc/udev/rules.d/70-net.rules", "# " + RULE % ("00A1", "can7") + RULE % ("77", "can9"))
    write(tmp_path, "sys/class/net/can_left/address", "")
    check_free(tmp_path, ADAPTER, "can0", ["can_left"])
    check_free(tmp_path, ADAPTER, "can_left", [])


def test_a_file_that_cannot_be_read_names_nothing(tmp_path):
    write(tmp_path, "etc/udev/rules.d/70-net.rules", "")
    (tmp_path / "etc/udev/rules.d/80-gone.rules").symlink_to("/nowhere")
    check_free(tmp_path, ADAPTER, "can0", [])
