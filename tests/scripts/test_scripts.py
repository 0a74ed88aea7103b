"""The scripts of a clone: they parse; the recording wrapper runs the stock command and says what came of it."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR
from tests.support import seeded_sets as seeds
from tests.support.night_table import table
from tests.support.paths import ROOT
from tests.support.terminal import Terminal
from tests.support.waiting import wait

STAND_IN = """#!/usr/bin/env bash
# In place of lerobot-record: says what it was asked, brings a data set, waits to be ended.
trap 'echo ended; exit 3' TERM
for argument in "$@"; do
  echo "given $argument"
  case "$argument" in --dataset.root=*) root=${argument#*=} ;; esac
done
cat "$SAYS" >&2
[[ -t 2 ]] && printf '\\r\\033[Kepisode 0: 9 s left\\r' >&2 && sleep 0.2
cp -r "$DATA" "$root"
for _ in $(seq "$LOOPS"); do sleep 0.05; done
"""

AT = "2026-11-28 12:52:47"
SAID = f"""INFO {AT} t_record.py:369 {{'dataset': {{'crf': 30,
             'fps': 30}}}}
INFO {AT} lerobot_robot_yam.control.process.control_process control loop of left_leader: SCHED_FIFO 20
INFO {AT} follower.py:115 sim BiYamFollower connected
[libx264 @ 0x7f1dac001dc0] 264 - core 165 - options: cabac=0
WARNING {AT} t_record.py:352 Record loop is running slower (15.3 Hz) than the target FPS (30 Hz).
WARNING {AT} s/images.py:115 waited 335 ms for images: top
WARNING {AT} s/images.py:115 waited 68 ms for images: top
Map:  50%|#####     | 1/2\rMap: 100%|##########| 2/2
Traceback (most recent call last):
  File "lerobot_record.py", line 1
INFO {AT} _episodes.py:41 kept 3 episodes of this session; 3 in data
  episode 1: recorded at 8.9 fps
"""
SHOWN = """sim BiYamFollower connected
warning: waited 335 ms for images: top
Traceback (most recent call last):
  File "lerobot_record.py", line 1
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A data set of three episodes, whose second one came too slowly."""
    root = seeds.write(tmp_path_factory.mktemp("recorded") / "data", map(seeds.motion, range(3)), cameras=())
    rows = []
    for episode in range(3):
        times = np.arange(seeds.FRAMES) / (seeds.FPS / 2 if episode == 1 else seeds.FPS)
        row = {"episode_index": episode, "fps": seeds.FPS, "times_s": times.tolist(), "repeated_images": {"top": 4}}
        rows.append(json.dumps(row | {"achieved_fps": (seeds.FRAMES - 1) / times[-1]}))
    (root / SIDE_CAR).write_text("\n".join(rows))
    return root


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


@pytest.fixture
def record_sim(tmp_path, recorded):
    """The command (program and arguments) and its environment, with the stand-in in the place of lerobot-record."""
    program, says = tmp_path / "lerobot-record", tmp_path / "says"
    program.write_text(STAND_IN)
    program.chmod(0o755)
    says.write_text(SAID)
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "LOOPS": "1", "DATA": recorded, "SAYS": says}
    command = [sys.executable, ROOT / "scripts" / "record_sim.py", f"--dataset.root={tmp_path / 'data'}"]
    return command, os.environ | environment | {"PYTHONPATH": str(ROOT)}


def test_recording_ends_with_the_place_of_the_data_their_quality_and_three_commands(tmp_path, record_sim):
    command, environment = record_sim
    command.append("--dataset.num_episodes=1")
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stderr == SHOWN
    assert (tmp_path / "data.log").read_bytes().decode() == SAID
    lines = done.stdout.splitlines()
    assert f"given --config_path={ROOT / 'configs/sim/record.yaml'}" in lines
    assert "given --dataset.num_episodes=1" in lines
    assert lines[-12:-9] == [
        "All that was said is in data.log; a warning that was shown came again 1 times",
        "The data set is in data",
        "  episode 0: 60 frames at 20.0 of 20 fps, 4 repeated images: good",
    ]
    assert lines[-9].startswith("  episode 1: 60 frames at 10.0 of 20 fps, 4 repeated images: WRONG: recorded at 10.0")
    assert lines[-7].startswith("What to do:  this machine was too busy; end other programs")
    assert lines[-5] == "Drop:        scripts/run yam-label data --set 1=discard --apply"
    looks = [line.partition("scripts/run ")[2] for line in lines[-4:-1]]
    assert looks[:2] == ["yam-view --dataset data", "yam-dataset-check data"]
    assert looks[2].startswith("lerobot-replay --config_path=") and lines[-1].split()[-1] == "--dataset.episode=0"


@pytest.mark.long
def test_a_terminal_stays_one_and_all_is_shown_on_demand(tmp_path, record_sim):
    command, environment = record_sim
    terminal = Terminal(tmp_path, *command, cwd=tmp_path, env=environment)
    assert terminal.end() == 0
    shown = terminal.shown
    assert all(f"{line}\r\n" in shown for line in SHOWN.splitlines())
    assert "\x1b[Kepisode 0: 9 s left\r" in shown and "Map:  50%" in shown and "Map: 100%" not in shown
    assert not re.search("SCHED_FIFO|crf|libx264|running slower|kept 3|at 8.9 fps", shown)
    terminal.close()
    shutil.rmtree(tmp_path / "data")
    done = subprocess.run([*command, "-v"], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stderr == SAID.replace("\r", "\n") and "given -v" not in done.stdout


def test_ending_the_wrapper_ends_the_recording(tmp_path, record_sim):
    command, environment = record_sim
    process = subprocess.Popen(command, env=environment | {"LOOPS": "400"}, stdout=subprocess.PIPE, text=True)
    wait(lambda: (tmp_path / "data" / "meta" / "info.json").exists(), 20.0)
    time.sleep(0.3)
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=20)
    assert "ended" in output and process.returncode == 3


def test_a_night_ends_with_a_table_of_what_fell():
    def report(name, outcome, seconds, longrepr=None):
        return pytest.TestReport(name, ("", 0, ""), {}, outcome, longrepr, "call", duration=seconds)

    stats = {
        "passed": [report("tests/arm/test_model.py::test_a", "passed", 60)],
        "failed": [report("tests/control/test_landing.py::test_b[yam]", "failed", 30, "it fell\nand more")],
        "": [report("tests/arm/test_model.py::test_a", "passed", 6)],  # setting it up
    }
    head, arm, control, total, fallen, _ = table(stats, seconds=90).splitlines()
    assert head.split()[:3] == ["tests", "passed", "failed"]
    assert arm.split() == ["tests/arm", "1", "0", "0", "0", "0", "1.1"]
    assert control.split() == ["tests/control", "0", "1", "0", "0", "0", "0.5"]
    assert total.split() == ["all", "1", "1", "0", "0", "0", "1.6"]
    assert fallen == "tests/control/test_landing.py::test_b[yam]: it fell"
