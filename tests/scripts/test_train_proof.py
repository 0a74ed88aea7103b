"""The training proof in miniature: data, training, evaluation, report; and what is done is not done again."""

import json
import subprocess
import sys

import pytest

from tests.support.paths import ROOT

SMALL = ("--episodes=2", "--steps=2", "--eval-episodes=2", "--batch_size=2", "--policy.dim_model=32")


def prove(out, *options):
    command = [sys.executable, "scripts/train_proof.py", f"--out={out}", *SMALL, *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.mark.long
@pytest.mark.timeout(900)
def test_from_nothing_to_a_report(tmp_path):
    out = tmp_path / "proof"
    (out / "train").mkdir(parents=True)  # of a training that was killed before its first checkpoint
    assert str(out / "report.md") in prove(out)
    report = (out / "report.md").read_text()
    assert "of 2 evaluation episodes succeeded" in report and "2 steps" in report and "evaluation 1000–1001" in report
    (done,) = (out / "eval").glob("000002-*-seeds-1000-1001/eval_info.json")
    outcomes = json.loads(done.read_text())
    assert len(outcomes["per_task"][0]["metrics"]["successes"]) == 2
    videos = [line.split("`")[1] for line in report.splitlines() if line.startswith("- `")]
    assert len(videos) == 2 and all((out / video).stat().st_size > 1000 for video in videos)
    assert (out / "loss.png").stat().st_size > 1000
    times = json.loads((out / "times.json").read_text())
    assert set(times) == {"gather", "train", "evaluate"}
    prove(out)
    assert json.loads((out / "times.json").read_text()) == times
    prove(out, "--steps=3")
    assert (out / "train.log").read_text().count("Start offline training") == 2  # it has gone on, with the third step
    assert "3 steps" in (out / "report.md").read_text()
