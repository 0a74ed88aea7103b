"""scripts/bench.py: which time counts, and a short run whose report has every figure."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from tests.support.paths import SCRIPTS


@pytest.fixture
def windows(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from bench import windows

    return windows


def test_only_ticks_in_undisturbed_windows_make_periods(windows):
    seen = windows.Windows(edges_s=[0.0, 1.0, 2.0, 3.0], good=[True, False, True])
    ticks = [0.5, 0.9, 1.5, 2.1, 2.5, 3.5]
    np.testing.assert_allclose(windows.periods(ticks, seen), [400.0, 400.0])
    assert seen.used_s == pytest.approx(2.0)
    assert seen.total_s == pytest.approx(3.0)


def test_a_window_with_stolen_time_does_not_count(windows, monkeypatch):
    samples = iter([(0, 0), (0, 200), (2, 400), (3, 600)])
    monkeypatch.setattr(windows, "stolen", lambda: next(samples))
    seen = windows.Windows()
    for _ in range(4):
        seen.mark()
    assert seen.good == [True, False, True]  # 0 %, 1 %, 0.5 %


def test_stolen_time_is_read_from_the_kernel(windows):
    stolen, total = windows.stolen()
    assert 0 <= stolen < total


def test_percentiles_are_named_as_the_report_names_them(windows):
    found = windows.percentiles(np.arange(1001.0), (50, 99, 99.9))
    assert found == pytest.approx({"p50": 500.0, "p99": 990.0, "p999": 999.0, "max": 1000.0})
    assert all(math.isnan(value) for value in windows.percentiles(np.zeros(0), (50,)).values())


def test_a_miss_says_what_nobody_could_have_reached(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from bench.report import TARGETS

    (target,) = [target for target in TARGETS if target.what == "the same, one arm"]

    def verdict(ours_hz, vendor_hz):
        report = {"wire_limit_hz": 550.0, "ours": {"unthrottled_hz": ours_hz}, "vendor": {"unthrottled_hz": vendor_hz}}
        return target.verdict(report).partition("1.8) ")[2]

    assert verdict(540.0, 300.0) == "met"
    assert verdict(530.0, 300.0) == "MISSED"
    assert verdict(549.0, 320.0) == "MISSED (the wire allows 1.72)"
    assert target.verdict({}).endswith("not measured")


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
        assert {"unthrottled_hz", "get_send_ms", "connect_s"} <= device.keys()
    assert {"cpu_per_arm", "import_ms", "age_after_lost_frame_ms"} <= ours.keys()
    assert figures["vendor"].keys() & {"chain_alone_hz", "missing"}
    assert "get + send, two arms" in run.stdout and "undisturbed" in run.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
