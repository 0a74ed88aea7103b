"""LeRobot's tracebacks about FFmpeg: one line where FFmpeg is not installed, all of them where something is wrong."""

import logging
import subprocess
import sys
from pathlib import Path

import lerobot.robots.config  # noqa: F401  which makes it register
import pytest
from lerobot.utils.import_utils import get_safe_default_video_backend

import lerobot_robot_yam  # noqa: F401
from tests.support.paths import ROOT

MISSING = "OSError: libavutil.so.{}: cannot open shared object file: No such file or directory"
BROKEN = "OSError: libtorchcodec_core7.so: undefined symbol: _ZNK3c105Error4whatEv"
OUTER = "The above exception was the direct cause of the following exception:\nOSError: Could not load this library: x"


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


def test_a_command_shows_its_real_error_and_no_page_about_ffmpeg(tmp_path):
    """Replaying what is not there, before anything is energised."""
    command = [Path(sys.executable).parent / "lerobot-replay", f"--config_path={ROOT / 'configs/sim/replay.yaml'}"]
    options = ["--dataset.repo_id=local/nothing", f"--dataset.root={tmp_path / 'nothing'}", "--dataset.episode=0"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=200)
    assert done.returncode != 0 and "FileNotFoundError" in done.stderr
    assert "libtorchcodec" not in done.stderr and done.stderr.count("FFmpeg") <= 1
