"""The stand-in for waldoctl, which is not on the package index."""

import sys

import pytest

from tests.support.paths import ROOT

STAND_IN = str(ROOT / "tests" / "waldo" / "stub")


@pytest.fixture
def waldoctl(monkeypatch):
    """waldoctl, in its newer form, can be imported in this process."""
    monkeypatch.syspath_prepend(STAND_IN)
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "waldoctl"]:
        del sys.modules[name]
