"""CAN adapters in a directory tree laid out as sysfs is."""

from lerobot_robot_yam.system.sysfs import read_adapters
from tests.support.doctor_desk import Sysfs


def test_an_adapter_and_the_hardware_behind_it(tmp_path):
    sysfs = Sysfs(tmp_path / "sys")
    sysfs.adapter("can0", "1-2.1", serial="0031AAAA", number="0x1", dev_port="1")
    (adapter,) = read_adapters(sysfs.root)
    assert (adapter.driver, adapter.usb.serial, adapter.usb.port) == ("gs_usb", "0031AAAA", "1-2.1")
    assert adapter.place == "/devices/pci0000:00/0000:00:14.0/usb1/1-2.1/1-2.1:1.0"
    assert (adapter.usb_interface, adapter.number) == ("1-2.1:1.0", ("0x1", "1"))
    sysfs.unplug("1-2.1")
    assert read_adapters(sysfs.root) == []
