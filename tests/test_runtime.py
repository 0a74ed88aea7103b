"""Where locks and the emergency stop live: the same place for every shell, and nobody else's."""

import os
import subprocess
import sys

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.runtime import runtime_dir

SAY = "from lerobot_robot_yam.runtime import runtime_dir; print(runtime_dir())"


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
