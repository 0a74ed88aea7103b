"""Where locks and the emergency stop live: the same place for every shell, and nobody else's."""

import os
import subprocess
import sys

import pytest

from lerobot_robot_yam.errors import BusError, ChannelInUseError, ConfigError
from lerobot_robot_yam.system.runtime_files import FileLock, runtime_dir
from tests.support.paths import ROOT

SAY = "from lerobot_robot_yam.system.runtime_files import runtime_dir; print(runtime_dir())"


def test_every_shell_of_a_user_finds_the_same_directory(tmp_path):
    here = {key: value for key, value in os.environ.items() if key != "YAM_RUNTIME_DIR"}
    bare = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}  # as cron and `docker exec` leave it
    said = [
        subprocess.run([sys.executable, "-c", SAY], env=env, capture_output=True, text=True, check=True).stdout
        for env in (bare, {**here, "XDG_RUNTIME_DIR": str(tmp_path), "TMPDIR": str(tmp_path)})
    ]
    assert said[0] == said[1] and said[0].strip().endswith(f"/yam-{os.getuid()}")


def test_a_directory_that_is_a_link_is_refused(monkeypatch, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path)
    monkeypatch.setenv("YAM_RUNTIME_DIR", str(tmp_path / "link"))
    with pytest.raises(ConfigError, match="link is not a directory of this user; set YAM_RUNTIME_DIR"):
        runtime_dir()


@pytest.mark.parametrize("mode", [0o770, 0o702, 0o1777])
def test_a_directory_that_is_open_to_others_is_refused(monkeypatch, tmp_path, mode):
    monkeypatch.setenv("YAM_RUNTIME_DIR", str(tmp_path))
    tmp_path.chmod(0o755)  # others may look
    assert runtime_dir() == tmp_path
    tmp_path.chmod(mode)
    with pytest.raises(ConfigError, match=rf"is open to others \(mode {mode:o}\).*chmod go-w .*YAM_RUNTIME_DIR"):
        runtime_dir()


def test_a_lock_ends_whatever_has_become_of_its_file(tmp_path):
    lock = FileLock(tmp_path / "lock", "a channel")
    lock.acquire()
    (tmp_path / "lock").unlink()
    (tmp_path / "lock").mkdir()
    lock.release()
    assert not lock.held and (tmp_path / "lock").is_dir()  # which is not its own
    with pytest.raises(BusError, match="a channel cannot be locked: .*directory"):
        lock.acquire()


HOLD = """
import sys
from pathlib import Path
from lerobot_robot_yam.system.runtime_files import FileLock
lock = FileLock(Path(sys.argv[1]), "a channel")
lock.acquire()
print("held", flush=True)
sys.stdin.read()
"""
CALL = """
import subprocess, sys
subprocess.run([sys.executable, *sys.argv[1:]])
"""


@pytest.mark.parametrize(
    "holder, named",
    [
        ("some-program", r"process \d+, some-program \(ps -p \d+\)"),
        (
            "lerobot_robot_yam.control.process.control_process",
            r"process \d+, which drives it for lerobot-teleoperate, process \d+ \(ps -p \d+\)",
        ),
    ],
)
def test_a_refusal_names_the_program_that_has_the_lock(tmp_path, holder, named):
    (tmp_path / holder).write_text(HOLD)
    (tmp_path / "lerobot-teleoperate").write_text(CALL)
    path = tmp_path / "lock"
    command = [sys.executable, "lerobot-teleoperate", holder, str(path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, **pipes) as process:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(ChannelInUseError, match=rf"a channel is in use by {named}; wait while it lands its arms"):
            FileLock(path, "a channel").acquire()
        process.stdin.close()
