"""scripts/bench_remote.py: a short run whose report has every figure."""

import json
import subprocess
import sys
from importlib.util import find_spec

import pytest

from tests.support.paths import SCRIPTS


@pytest.mark.long
@pytest.mark.alone
def test_a_short_run_reports_every_figure(tmp_path):
    report = tmp_path / "bench_remote.json"
    command = [sys.executable, str(SCRIPTS / "bench_remote.py"), "--quick", "--json", str(report)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert run.returncode == 0, run.stderr
    rows = json.loads(report.read_text())["rows"]
    portal = ["portal"] * (find_spec("portal") is not None)
    assert list(rows) == ["local", "link", "lekiwi at 30 Hz", "lekiwi at 250 Hz", *portal]
    assert ("portal is not installed" in run.stdout) is not bool(portal)
    assert rows["link"]["states"] > 300 and rows["link"]["added_age"]["p99_ms"] > 0
    assert all(row["latency"]["p50_ms"] > 0 for row in rows.values())
