"""Commands of this very installation as a person types them.

The environment of a clone is not on the PATH, and root has another PATH. So messages name files.
"""

import shlex
import sys
import sysconfig
from pathlib import Path


def as_root(command: str) -> str:
    """A console command of ours with its options, run by root: "sudo /…/bin/yam-setup-can --reset"."""
    name, *options = command.split(" ", 1)
    return " ".join(["sudo", shlex.quote(str(Path(sysconfig.get_path("scripts"), name))), *options])


def install_extra(extra: str) -> str:
    """How to install an optional part of this package: editable, or it would replace a clone's own installation."""
    return f'install it in the clone of this package: {shlex.quote(sys.executable)} -m pip install -e ".[{extra}]"'
