"""The scripts of a clone: they parse, and the recording wrapper runs the stock command and says where the data are."""

import os
import signal
import subprocess
import sys
import time

import pytest

from tests.support.paths import ROOT

STAND_IN = """#!/usr/bin/env bash
# In place of lerobot-record: says what it was asked, begins a data set, waits to be ended.
trap 'echo ended; exit 3' TERM
for argument in "$@"; do
  echo "given $argument"
  case "$argument" in --dataset.root=*) root=${argument#*=} ;; esac
done
mkdir -p "$root/meta" && echo '{"total_episodes": 1, "total_frames": 90}' >"$root/meta/info.json"
for _ in $(seq "$LOOPS"); do sleep 0.05; done
"""


@pytest.mark.parametrize(
    "script", ["scripts/run", "scripts/test", "scripts/record_sim", "scripts/train_proof", ".ci/run"]
)
def test_shell_scripts_parse_and_can_be_run(script):
    assert os.access(ROOT / script, os.X_OK)
    subprocess.run(["bash", "-n", script], cwd=ROOT, check=True)


def test_ci_runs_exactly_the_readmes_second_command():
    assert "scripts/test" in (ROOT / ".ci" / "run").read_text()
    commands = [block.partition("```")[0].strip() for block in (ROOT / "README.md").read_text().split("```bash\n")[1:]]
    assert commands[:2] == ["scripts/record_sim", "scripts/test"]


def test_run_without_a_command_says_what_to_give():
    done = subprocess.run(["scripts/run"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2 and "lerobot-record" in done.stderr


def start_record_sim(tmp_path, loops, *arguments):
    program = tmp_path / "lerobot-record"
    program.write_text(STAND_IN)
    program.chmod(0o755)
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "LOOPS": str(loops)}
    return subprocess.Popen(
        [sys.executable, str(ROOT / "scripts" / "record_sim.py"), f"--dataset.root={tmp_path / 'data'}", *arguments],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )


def test_recording_says_where_the_data_are(tmp_path):
    process = start_record_sim(tmp_path, 1, "--dataset.num_episodes=1")
    output, _ = process.communicate(timeout=20)
    assert process.returncode == 0
    assert f"given --config_path={ROOT / 'configs/sim/record.yaml'}" in output
    assert "given --dataset.num_episodes=1" in output
    assert f"The data set is in {tmp_path / 'data'}" in output.splitlines()
    assert "It has 1 episodes, 90 frames" in output.splitlines()


def test_ending_the_wrapper_ends_the_recording(tmp_path):
    process = start_record_sim(tmp_path, 400)
    deadline = time.monotonic() + 20.0
    while not (tmp_path / "data" / "meta" / "info.json").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    time.sleep(0.3)
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=20)
    assert "ended" in output and process.returncode == 3
