"""scripts/bench_ik.py: a short run whose report has every figure."""

import json
import subprocess
import sys

import pytest

from tests.support.paths import SCRIPTS


@pytest.mark.long
def test_a_short_run_reports_every_figure(tmp_path):
    report = tmp_path / "bench_ik.json"
    command = [sys.executable, str(SCRIPTS / "bench_ik.py"), "--quick", "--arms", "yam", "--json", str(report)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert run.returncode == 0, run.stderr
    figures = json.loads(report.read_text())
    for kind in ("random", "path"):
        row = figures["yam"][kind]
        assert row["solved"] > 0.9 and row["count"] >= 50
        assert 0 < row["p50_ms"] <= row["p99_ms"] <= row["p100_ms"] and f"{row['p99_ms']:.2f}" in run.stdout
