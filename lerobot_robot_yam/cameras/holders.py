"""Who may use a device file, and who does: rights, and the processes that have it open, from /proc."""

import grp
import os
from collections.abc import Sequence
from pathlib import Path

from lerobot_robot_yam.errors import CameraError
from lerobot_robot_yam.system.own_commands import as_root


def holders(paths: Sequence[Path]) -> list[tuple[int, str]]:
    """Number and name of each other process that has one of these files open. Of other users, root alone sees them."""
    wanted = {os.path.realpath(path) for path in paths}
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            files = {os.readlink(entry) for entry in os.scandir(process / "fd")}
            if int(process.name) != os.getpid() and files & wanted:
                found.append((int(process.name), (process / "comm").read_text().strip()))
        except OSError:
            continue  # it has ended, or is somebody else's
    return sorted(found)


def in_use(paths: Sequence[Path]) -> str:
    """Who has the files open, and what to do, for a message."""
    who = [f"process {pid} ({name})" for pid, name in holders(paths)]
    if not who:
        return "no process of yours has it open; `sudo fuser -v /dev/video*` shows others. Else plug it in again"
    return f"{' and '.join(who)} {'has' if len(who) == 1 else 'have'} it open: end that program first"


def check_rights(path: Path) -> None:
    """Refuse a device file that this user may not read and write.

    Raises:
        CameraError: names the group that may, or says that the file is not there.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise CameraError(f"{path} is not there: {error.strerror}") from error
    if os.access(path, os.R_OK | os.W_OK, effective_ids=True):
        return
    try:
        group = grp.getgrgid(status.st_gid).gr_name
    except KeyError:
        group = str(status.st_gid)
    remedy = (
        f"`{as_root('yam-setup-can --rights')}` gives it to the group video"
        if group == "root"
        else f"join the group {group} (`sudo usermod -aG {group} $USER`)"
    )
    raise CameraError(f"no right to open {path}: {remedy}, then log in again")
