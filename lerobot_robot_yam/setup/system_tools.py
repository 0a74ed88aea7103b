"""System tools that make changes take effect. With a root other than "/", only usermod runs; others are only shown.

A systemd unit for each named adapter brings the CAN link up, at plug-in, at boot, and when started by hand.
All target systems run systemd, but not systemd-networkd: Debian, Ubuntu's desktop and Raspberry Pi OS use
NetworkManager or ifupdown, which do not support CAN. udev's manual forbids network programs in udev rules.
"""

import shutil
import subprocess
from collections.abc import Callable, Sequence

from lerobot_robot_yam.damiao.tables import BITRATE
from lerobot_robot_yam.doctor.check_link import NO_RESTART, QUEUE_LENGTH, RESTART_MS
from lerobot_robot_yam.errors import ChannelInUseError, SetupError
from lerobot_robot_yam.setup.adapter_rules import RULES
from lerobot_robot_yam.setup.rights import RULES_OF_DEVICES
from lerobot_robot_yam.setup.system_files import Change, GroupChange, SystemFiles
from lerobot_robot_yam.state.records import channel_key
from lerobot_robot_yam.system.runtime_dirs import lock_holders, runtime_dirs
from lerobot_robot_yam.system.sysfs import CanAdapter, text_of

_TIMEOUT_S = 30.0
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


class SystemTools:
    """Runner of the system's tools on the computer that `files` belong to.

    Args:
        tell: receives each command as a line of text, before it is run.
        dry: whether to show commands without running them.
    """

    def __init__(self, files: SystemFiles, tell: Callable[[str], None], dry: bool):
        self._files, self._tell = files, tell
        self._dry_run = dry
        self._dry = dry or not files.live

    def load(self, changes: Sequence[Change]) -> None:
        """Change groups, also below another root, and make udev and systemd reload changed files."""
        for change in changes:
            if isinstance(change, GroupChange):
                root = [] if self._files.live else ["--prefix", str(self._files.root)]
                how = "--append" if change.joins else "--remove"
                usermod = shutil.which("usermod") or "/usr/sbin/usermod"  # not on every PATH
                self._run([usermod, *root, how, "--groups", ",".join(change.groups), change.user], self._dry_run)
        paths = {change.path for change in changes if not isinstance(change, GroupChange)}
        if paths & {RULES, RULES_OF_DEVICES}:
            self._run("udevadm control --reload".split())
        if RULES_OF_DEVICES in paths:
            self._run("udevadm trigger --subsystem-match=usb --subsystem-match=misc".split())
        if UNIT in paths:
            self._run("systemctl daemon-reload".split())

    def rename(self, interface: str, name: str) -> bool:
        """Let udev rename a connected adapter by its rule, and bring the link up; return whether the renaming worked.

        Renaming fails while another adapter has the name, such as when two adapters swap names.
        """
        index = self._index(interface)
        if interface != name:
            self._run(["ip", "link", "set", interface, "down"])  # an interface cannot be renamed while it is up
            self._run(["udevadm", "trigger", "--action=add", f"/sys/class/net/{interface}"])
            self._run(["udevadm", "settle"])
        if not self._dry and (index is None or self._index(name) != index):
            return False
        self._run(["systemctl", "restart", f"yam-can@{name}.service"])
        return True

    def reset(self, adapter: CanAdapter) -> None:
        for command in bring_up(adapter):
            self._run(command)

    def _index(self, interface: str) -> str | None:
        """Return the kernel's index of an interface, which survives renaming; None if there is no such interface."""
        return text_of(self._files.root / "sys/class/net" / interface / "ifindex")

    def _run(self, command: Sequence[str], dry: bool | None = None) -> None:
        dry = self._dry if dry is None else dry
        self._tell(f"{'would run' if dry else 'runs'}: {' '.join(command)}")
        if dry:
            return
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise SetupError(f"{' '.join(command)} failed: {error}") from error
        if done.returncode != 0:
            raise SetupError(f"{' '.join(command)} failed: {done.stderr.strip() or done.returncode}")


def bring_up(adapter: CanAdapter) -> list[list[str]]:
    """Return the commands that take a link down and bring it up with the settings that the arms need."""
    commands = [f"ip link set {adapter.name} down"]
    if adapter.driver is not None and adapter.driver not in NO_RESTART:
        commands.append(f"ip link set {adapter.name} type can restart-ms {RESTART_MS}")
    commands.append(f"ip link set {adapter.name} {_UP}")
    return [command.split() for command in commands]


def check_undriven(interfaces: Sequence[str]) -> None:
    """Check that no program of any user uses a link: its arm would fall, or a motor would stay half configured.

    Raises:
        ChannelInUseError: a program uses a link; the message names the channel and the process.
    """
    keys = {channel_key("socketcan", name, None) for name in interfaces}
    for directory in runtime_dirs():
        for key, process in lock_holders(directory).items():
            if key in keys:
                raise ChannelInUseError(f"{key} is used by process {process}: end it, which lands its arm")
