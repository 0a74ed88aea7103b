"""Every name that we and our tests import from LeRobot is there: the first to fail when LeRobot moves one.

scripts/run pytest tests/face/devices/test_lerobot_names.py --lerobot=PATH
"""

import ast
import importlib
import importlib.metadata
import os
import re
import subprocess
import sys

import lerobot
import pytest

from tests.support.paths import ROOT

SOURCES = ("lerobot_robot_yam", "lerobot_strategy_yam", "lerobot_teleoperator_yam", "scripts", "tests")

FROM_LEROBOT = re.compile(r"\b(from|import) lerobot\b")


def names():
    """(module, name or None) of all imports from LeRobot, sorted."""
    found = set()
    texts = (path.read_text() for source in SOURCES for path in (ROOT / source).rglob("*.py"))
    for text in filter(FROM_LEROBOT.search, texts):  # reading is quick, and parsing a thousand files is not
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom):
                found |= {(node.module, alias.name) for alias in node.names}
            elif isinstance(node, ast.Import):
                found |= {(alias.name, None) for alias in node.names}
    return sorted((pair for pair in found if (pair[0] or "").partition(".")[0] == "lerobot"), key=str)


@pytest.mark.parametrize("module, name", names())
def test_lerobot_has_it(module, name):
    loaded = importlib.import_module(module)
    assert name is None or hasattr(loaded, name) or importlib.import_module(f"{module}.{name}")


def test_here_and_in_commands_it_is_the_lerobot_that_was_asked_for(pytestconfig):
    tree = pytestconfig.getoption("lerobot")
    say = "import lerobot, importlib.metadata as m; print(lerobot.__file__, lerobot.__version__, m.version('lerobot'))"
    told = subprocess.run([sys.executable, "-c", say], capture_output=True, text=True, check=True).stdout.split()
    assert told == [lerobot.__file__, lerobot.__version__, importlib.metadata.version("lerobot")]
    assert told[1] == told[2]
    if tree is not None:
        assert os.path.realpath(told[0]) == os.path.realpath(tree / "src" / "lerobot" / "__init__.py")
        assert f'version = "{told[1]}"' in (tree / "pyproject.toml").read_text()
