"""What is said before anything else of a LeRobot command runs.

A config file that is no YAML is one line that names file, line and cause. LeRobot's tracebacks about FFmpeg are one
line where FFmpeg is not installed, and whole where something else is wrong.
"""

import logging
import subprocess
import sys
from pathlib import Path

import lerobot.robots.config  # noqa: F401  which makes it register
import pytest
from lerobot.utils.import_utils import get_safe_default_video_backend

from lerobot_robot_yam.face.start_messages import refuse_unreadable
from tests.support.paths import ROOT

RECORD, REPLAY = (Path(sys.executable).with_name(name) for name in ("lerobot-record", "lerobot-replay"))
MISSING = "OSError: libavutil.so.{}: cannot open shared object file: No such file or directory"
BROKEN = "OSError: libtorchcodec_core7.so: undefined symbol: _ZNK3c105Error4whatEv"
OUTER = "The above exception was the direct cause of the following exception:\nOSError: Could not load this library: x"


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


def torchcodec_error(*causes):
    """What torchcodec raises when every attempt to load it has failed."""
    attempts = [f"FFmpeg version {8 - n}:\nTraceback …\n{cause}\n\n{OUTER}\n" for n, cause in enumerate(causes)]
    inner = "\n".join(attempts)
    return (
        "Could not load libtorchcodec. Likely causes: 1. FFmpeg is not properly installed …\n"
        f"[start of libtorchcodec loading traceback]\n{inner}[end of libtorchcodec loading traceback]."
    )


@pytest.fixture
def attempt(monkeypatch, caplog):
    """Lets LeRobot choose how to read videos, with a torchcodec that cannot be loaded; returns what it logs."""
    for one in logging.getLogger("lerobot.utils.import_utils").filters:
        monkeypatch.setattr(one, "told", False)

    def choose(error):
        def fail(name):
            raise RuntimeError(error)

        monkeypatch.setattr("lerobot.utils.import_utils.importlib.import_module", fail)
        caplog.clear()
        with caplog.at_level(logging.INFO):
            assert get_safe_default_video_backend() == "pyav"
        monkeypatch.undo()
        return [record.getMessage() for record in caplog.records]

    return choose


def test_ffmpeg_that_is_not_there_is_one_line_once(attempt):
    error = torchcodec_error(*(MISSING.format(n) for n in (60, 59, 58, 57, 56)))
    (line,) = attempt(error)
    assert "PyAV" in line and "\n" not in line


@pytest.mark.parametrize(
    "error",
    [
        torchcodec_error(MISSING.format(60), BROKEN, MISSING.format(58)),
        torchcodec_error(BROKEN),
        "libtorch.so is gone",
        "Could not load libtorchcodec for a reason of its own",
    ],
)
def test_any_other_reason_is_shown_in_full(attempt, error):
    (text,) = attempt(error)
    assert error in text


@pytest.mark.long
def test_a_command_shows_its_real_error_and_no_page_about_ffmpeg(tmp_path):
    """Replaying what is not there, before anything is energised."""
    command = [REPLAY, f"--config_path={ROOT / 'configs/sim/replay.yaml'}"]
    options = ["--dataset.repo_id=local/nothing", f"--dataset.root={tmp_path / 'nothing'}", "--dataset.episode=0"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=200)
    assert done.returncode != 0 and done.stderr.strip().splitlines()[-1].startswith("error: there is no data set in ")
    assert "libtorchcodec" not in done.stderr and done.stderr.count("FFmpeg") <= 1
