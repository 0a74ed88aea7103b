"""Calls that come from LeRobot's own code, as far as the stack tells."""

from pathlib import Path

import lerobot
from draccus import argparsing

SCRIPTS = Path(lerobot.__path__[0]) / "scripts"


def called_by(file, function, call, **values):
    """Call `call` from a function of that name and file, which has these local variables."""
    names = "".join(f", {name}" for name in values)
    code = compile(f"def {function}(call{names}):\n    return call()\n", str(file), "exec")
    scope = {}
    exec(code, scope)
    return scope[function](call, **values)


def while_parsing(call, **options):
    """Call `call` while LeRobot's parser decodes these options, nested as in a config file."""
    return called_by(argparsing.__file__, "_postprocessing", call, deflat_d=options)
