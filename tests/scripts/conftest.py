"""The soak's modules, which scripts import from their own folder."""

import pytest

from tests.support.paths import SCRIPTS


@pytest.fixture
def soak(monkeypatch):
    """The soak's modules."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import soak.arm
    import soak.checks
    import soak.context
    import soak.coupled
    import soak.injected_faults
    import soak.obedience
    import soak.schedule
    import soak.seeds
    import soak.truth

    return soak
