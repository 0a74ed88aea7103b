"""scripts/bench_view.py: a short run whose report has every figure, and a page that kept up with four arms."""

import json
import subprocess
import sys

import pytest

from tests.support.paths import SCRIPTS


@pytest.mark.long
@pytest.mark.alone
def test_a_short_run_reports_every_figure(tmp_path):
    report = tmp_path / "bench_view.json"
    command = [sys.executable, str(SCRIPTS / "bench_view.py"), "--quick", "--json", str(report)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert run.returncode == 0, run.stderr
    rows = json.loads(report.read_text())["rows"]
    assert list(rows) == ["alone", "page", "page and browser"]
    for row in rows.values():
        assert row["frames"] > 100 and 0 < row["loop_p99_ms"] <= row["loop_max_ms"]
    assert rows["page and browser"]["updates_hz"] > 0 and rows["page"]["page_cpu"] > 0
    assert "| updates_hz | – | – |" in run.stdout
