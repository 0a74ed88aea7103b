"""A separate control group for the stand-by: what freezes or kills the control process's group spares it.

Where systemd runs the machine it puts the stand-by into a scope. Elsewhere a group beside ours is made, where that is
allowed. The result is logged: nothing depends on it until a whole group is frozen or killed.
"""

import contextlib
import os
import pwd
import subprocess
import time
from pathlib import Path

_PREFIX = "yam-stand-by-"
_GROUPS = Path("/proc/self/cgroup")
_BOOTED = Path("/run/systemd/system")  # there while systemd runs the machine, see sd_booted(3)
_LINGER = Path("/var/lib/systemd/linger")
_ASK_S, _MOVED_S = 5.0, 2.0
_SHARED = "shares its control group with the control process, so that a freezer or out-of-memory killer takes both: "


def leave_group() -> str:
    """Move this process into a separate control group; returns the result for the log. Takes up to 7 s."""
    before = _group()
    if before in ("", "/"):
        return "is in no control group but the machine's, or its container's"
    try:
        if _BOOTED.exists():
            _ask_systemd(before)
        else:
            _make_group(before)
    except (OSError, KeyError, subprocess.TimeoutExpired) as error:  # KeyError: a user without a name
        return f"{_SHARED}{error}"
    deadline = time.monotonic() + _MOVED_S
    while (now := _group()) == before:
        if time.monotonic() > deadline:
            return _SHARED + "systemd has not moved it"
        time.sleep(0.02)
    return f"has a control group of its own, {now}"


def _group() -> str:
    """Path of our group in version 2 of the hierarchy, empty where the kernel has no version 2."""
    lines = _GROUPS.read_text().splitlines()
    return next((line.removeprefix("0::") for line in lines if line.startswith("0::")), "")


def _ask_systemd(group: str) -> None:
    """Have the manager that lives as long as we do make a scope.

    Raises:
        OSError, TimeoutExpired: no manager answers, or it refuses.
    """
    uid, environment = os.getuid(), dict(os.environ)
    if uid:
        # At log-out the user's manager ends with all its scopes; processes started in a session may live on.
        if f"/user@{uid}.service/" not in group and not (_LINGER / pwd.getpwuid(uid).pw_name).exists():
            raise OSError(f"the user's systemd ends before it; `loginctl enable-linger` keeps that (group {group})")
        environment.setdefault("XDG_RUNTIME_DIR", f"/run/user/{uid}")
    name, pid = "org.freedesktop.systemd1", str(os.getpid())
    call = ["busctl", "--user" if uid else "--system", "call", name, "/org/freedesktop/systemd1", f"{name}.Manager"]
    call += ["StartTransientUnit", "ssa(sv)a(sa(sv))", f"{_PREFIX}{pid}.scope", "fail"]
    call += ["2", "Description", "s", "lands YAM arms whose control process has died", "PIDs", "au", "1", pid, "0"]
    null, pipe = subprocess.DEVNULL, subprocess.PIPE
    done = subprocess.run(call, env=environment, stdin=null, stdout=null, stderr=pipe, text=True, timeout=_ASK_S)
    if done.returncode:
        raise OSError(f"systemd refuses: {done.stderr.strip()}")


def _make_group(group: str) -> None:
    """Make one beside ours.

    Raises:
        OSError: we may not.
    """
    beside = Path(_mount() + group).parent
    for left in beside.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):  # a process is in it still
            left.rmdir()
    own = beside / f"{_PREFIX}{os.getpid()}"
    own.mkdir()
    try:
        (own / "cgroup.procs").write_text(f"{os.getpid()}\n")
    except OSError:
        own.rmdir()
        raise


def _mount() -> str:
    """Where the whole hierarchy is mounted.

    Raises:
        OSError: nowhere.
    """
    for line in Path("/proc/self/mountinfo").read_text().splitlines():
        where, _, what = line.partition(" - ")
        if what.startswith("cgroup2 ") and where.split()[3] == "/":
            return where.split()[4]
    raise OSError("version 2 of the control groups is not mounted")
