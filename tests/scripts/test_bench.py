"""scripts/bench.py: a short run whose report has every figure."""

import json
import subprocess
import sys

import pytest

from tests.support.paths import SCRIPTS


@pytest.mark.long
@pytest.mark.alone
def test_a_short_run_reports_every_figure(tmp_path):
    report, picture = tmp_path / "bench.json", tmp_path / "bench.png"
    durations = ["--quick", "--seconds", "0.5", "--short-seconds", "0.3"]
    command = [sys.executable, str(SCRIPTS / "bench.py"), *durations, "--json", str(report), "--plot", str(picture)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert run.returncode == 0, run.stderr
    figures = json.loads(report.read_text())
    assert figures["wire_limit_hz"] == pytest.approx(549.45, abs=0.01)
    ours, peer = figures["ours"], figures["damiao_bus"]
    for name in ("idle_ms", "hogged_ms", "thread_hogged_ms"):
        assert {"p50", "p99", "p999", "max"} <= ours[name].keys()
    for device in (ours, peer):
        assert {"p50", "p99"} <= device["age_ms"].keys()
        assert {"unthrottled_hz", "unthrottled_latency_hz", "get_send_ms", "get_send_paced_ms"} <= device.keys()
    assert {"cpu_per_arm", "unthrottled_two_arms_hz"} <= ours.keys()
    assert figures["vendor"].keys() & {"chain_alone_hz", "missing"}
    assert "get_send_ms" in run.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
