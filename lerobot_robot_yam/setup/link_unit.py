"""Bring-up of a CAN link: a systemd unit for each named adapter, at plug-in and at boot, and the same by hand.

All target systems run systemd, but not systemd-networkd: Debian, Ubuntu's desktop and Raspberry Pi OS use
NetworkManager or ifupdown, which do not support CAN. And udev's manual keeps network programs out of its rules.
"""

from lerobot_robot_yam.damiao.tables import BITRATE
from lerobot_robot_yam.doctor.check_link import NO_RESTART, QUEUE_LENGTH, RESTART_MS
from lerobot_robot_yam.setup.adapter_rules import RULES
from lerobot_robot_yam.system.sysfs import CanAdapter

UNIT = "etc/systemd/system/yam-can@.service"
_UP = f"up txqueuelen {QUEUE_LENGTH} type can bitrate {BITRATE}"  # `ip` accepts txqueuelen only before the type
_IS_NO_RESTART = " || ".join(f"[ /sys/class/net/%i/device/driver -ef /sys/bus/usb/drivers/{d} ]" for d in NO_RESTART)
UNIT_TEXT = f"""\
# Written by yam-setup-can; `yam-setup-can --undo` takes it away. /{RULES} starts it.
[Unit]
Description=CAN bus of an arm on %i at {BITRATE} bit/s
BindsTo=sys-subsystem-net-devices-%i.device
After=sys-subsystem-net-devices-%i.device

[Service]
Type=oneshot
RemainAfterExit=yes
ExecStart=-ip link set %i down
# Some drivers cannot restart a controller: newer kernels refuse this for them, older ones crash at bus-off.
ExecStart=-sh -c '{_IS_NO_RESTART} || ip link set %i type can restart-ms {RESTART_MS}'
ExecStart=ip link set %i {_UP}
"""


def bring_up(adapter: CanAdapter) -> list[list[str]]:
    """List the commands that take a link down and bring it up as the arms need it."""
    commands = [f"ip link set {adapter.name} down"]
    if adapter.driver is not None and adapter.driver not in NO_RESTART:
        commands.append(f"ip link set {adapter.name} type can restart-ms {RESTART_MS}")
    commands.append(f"ip link set {adapter.name} {_UP}")
    return [command.split() for command in commands]
