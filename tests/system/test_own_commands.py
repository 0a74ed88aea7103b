"""Commands that messages name: they work as they stand, in an environment that is on no PATH."""

import os
import shlex
import subprocess
import sysconfig

from lerobot_robot_yam.system.own_commands import as_root, install_extra


def test_a_command_for_root_is_the_file_of_this_installation():
    sudo, program, option = shlex.split(as_root("yam-estop status"))
    assert (sudo, option) == ("sudo", "status") and os.access(program, os.X_OK)
    done = subprocess.run([program, option], capture_output=True, text=True, env=os.environ | {"PATH": ""}, timeout=60)
    assert done.returncode == 0 and "emergency stop" in done.stdout


def test_a_path_with_a_space_is_one_word(monkeypatch):
    monkeypatch.setattr(sysconfig, "get_path", lambda name: f"/home/me/my arms/{name}")
    assert as_root("yam-setup-can --reset") == "sudo '/home/me/my arms/scripts/yam-setup-can' --reset"


def test_an_extra_is_installed_with_the_interpreter_that_lacks_it():
    python, *options = shlex.split(install_extra("view").partition(": ")[2])
    assert options == ["-m", "pip", "install", "-e", ".[view]"]
    done = subprocess.run([python, "-c", "import lerobot_robot_yam"], cwd="/", capture_output=True, timeout=60)
    assert done.returncode == 0
