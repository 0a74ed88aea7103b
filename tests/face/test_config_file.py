"""A config file that is no YAML: one line that names file, line and cause, before anything else of the command runs."""

import subprocess
import sys
from pathlib import Path

import pytest

from lerobot_robot_yam.face.config_file import refuse_unreadable

RECORD = Path(sys.executable).with_name("lerobot-record")


@pytest.mark.long
def test_lerobot_says_where_the_tab_is(tmp_path):
    (tmp_path / "run.yaml").write_text("robot:\n  id: lab\n\ttype: bi_yam_follower\n")
    command = [RECORD, f"--config_path={tmp_path}/run.yaml"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.stderr.splitlines() == [f"error: {tmp_path}/run.yaml, line 3: a tab; indent with blanks"]
    assert run.returncode == 2 and not run.stdout


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("robot: {type: yam_follower\nteleop: 3\n", "line 2: expected ',' or '}'"),
        ("robot: 'bi_yam_follower\n", "line 2: found unexpected end of stream"),
        ("a: 1\n b: 2\n", "line 2: mapping values are not allowed here"),
    ],
)
def test_other_mistakes_are_named_by_line(monkeypatch, capsys, tmp_path, text, says):
    (tmp_path / "run.yaml").write_text(text)
    monkeypatch.setattr(sys, "argv", ["lerobot-teleoperate", f"--config_path={tmp_path}/run.yaml"])
    with pytest.raises(SystemExit):
        refuse_unreadable()
    assert says in capsys.readouterr().err


@pytest.mark.parametrize("program", ["lerobot-record", "train.py"])
@pytest.mark.parametrize("name", ["there.yaml", "not_there.yaml", "hub/config"])
def test_what_can_be_read_or_is_not_ours_to_read_passes(monkeypatch, tmp_path, program, name):
    (tmp_path / "there.yaml").write_text("\ta: 1" if program == "train.py" else "a: 1")
    monkeypatch.setattr(sys, "argv", [program, f"--config_path={tmp_path / name}"])
    refuse_unreadable()
