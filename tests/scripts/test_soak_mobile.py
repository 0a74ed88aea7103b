"""scripts/soak.py --mobile: a short run keeps all promises, and its judge sees a broken one."""

import pytest

from tests.support.paths import SCRIPTS

SECONDS, PACE = 18.0, 6.0  # the rail homes for 11 s of them


@pytest.fixture
def mobile(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import soak.mobile
    import soak.mobile_judge

    return soak


@pytest.mark.long
def test_a_short_run_keeps_every_promise(mobile):
    report = mobile.mobile.soak_mobile(SECONDS / 60.0, 3, PACE)
    assert report["violations"] == []
    assert sum(report["injected"].values()) > 20 and report["caller"]["counts"]["connected"] >= 1


@pytest.mark.long
def test_the_judge_sees_a_base_that_accelerates_too_fast(mobile, monkeypatch):
    monkeypatch.setattr(mobile.mobile_judge, "HARD_CAP_ACCELERATION", (0.1, 0.1, 0.1))
    report = mobile.mobile.soak_mobile(SECONDS / 60.0, 3, 0.01)
    assert {row["violation"] for row in report["violations"]} == {"acceleration"}
