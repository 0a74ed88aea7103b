"""Rights of a user: real-time scheduling and locked memory, cameras, uinput. Raw CAN sockets need no rights."""

from collections.abc import Mapping

from lerobot_robot_yam.control.process.control_process import RT_PRIORITY
from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.setup.system_files import ACCOUNT, Change, GroupChange, SystemFiles

LIMITS = "etc/security/limits.d/90-yam.conf"
RULES_OF_DEVICES = "etc/udev/rules.d/70-yam-devices.rules"
_DEVICES = """\
# Written by yam-setup-can; `yam-setup-can --undo` takes it away.
# RealSense cameras by way of USB, as video devices are: for the group video.
SUBSYSTEM=="usb", ATTR{idVendor}=="8086", ATTR{product}=="*RealSense*", GROUP="video", MODE="0660"
# Programs that type keys (foot pedals, buttons of handles): for the group input.
KERNEL=="uinput", SUBSYSTEM=="misc", GROUP="input", MODE="0660", OPTIONS+="static_node=uinput"
"""
_GROUPS = ("video", "input")
_USERS = "etc/passwd"


def rights_changes(files: SystemFiles, user: str) -> list[Change]:
    """Return the changes that grant a user the rights.

    Raises:
        SetupError: the user or a group does not exist, or a file cannot be read.
    """
    users = [line.partition(":")[0] for line in (files.read(_USERS) or "").splitlines()]
    if user not in users or not ACCOUNT.fullmatch(user):
        raise SetupError(f"there is no user {user!r} in /{_USERS}: say who drives the arms (--user NAME)")
    members = files.members()
    missing = sorted(set(_GROUPS) - set(members))
    if missing:
        raise SetupError(
            f"there is no group {' and no group '.join(missing)} in /etc/group: make it (sudo groupadd --system "
            f"{missing[0]}), or give names only (--no-rights)"
        )
    lines = (files.read(LIMITS) or "").splitlines()
    wanted = [f"{user} - rtprio {RT_PRIORITY}", f"{user} - memlock unlimited"]
    limits = "".join(f"{line}\n" for line in [*lines, *(line for line in wanted if line not in lines)])
    changes = files.change_to(LIMITS, limits) + files.change_to(RULES_OF_DEVICES, _DEVICES)
    new = tuple(group for group in _GROUPS if user not in members[group])
    return [*changes, GroupChange(user, new)] if new else changes


def user_of(environment: Mapping[str, str]) -> str | None:
    """Return the user who called sudo, or else the user who is logged in; None for root."""
    name = environment.get("SUDO_USER") or environment.get("USER") or environment.get("LOGNAME")
    return None if name in (None, "root") else name
