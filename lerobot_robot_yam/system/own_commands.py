"""Command lines of this installation, for messages.

Commands are given as file paths, since the environment of a clone is not on the PATH, and root has another PATH.
"""

import shlex
import sys
import sysconfig
from pathlib import Path


def as_root(command: str) -> str:
    """Format a console command of this package, with its options, for root: "sudo /…/bin/yam-setup-can --reset"."""
    name, *options = command.split(" ", 1)
    return " ".join(["sudo", shlex.quote(str(Path(sysconfig.get_path("scripts"), name))), *options])


def install_extra(extra: str) -> str:
    """Format the command that installs an optional part of this package; editable, so that the clone remains in use."""
    return f'install it in the clone of this package: {shlex.quote(sys.executable)} -m pip install -e ".[{extra}]"'
