"""README and the first pages: short enough to read, and their Python, installation and commands do what they say."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import can
import pytest

from lerobot_robot_yam.commands.configs import config_names
from lerobot_robot_yam.face.datasets.check.flags import Kind
from lerobot_robot_yam.rig.control import running_rig
from tests.support.pages import README, block, blocks, section
from tests.support.paths import ROOT

QUICK_START, INSTALLATION = "docs/quick-start.md", "docs/installation.md"
MOST_WORDS = 600  # with its tables


def test_the_readme_is_read_in_two_minutes():
    targets = re.sub(r"\]\(\S+\)", "]", README.read_text())
    assert len(targets.split()) < MOST_WORDS


def test_the_first_screen_has_the_hazard_the_command_and_the_picture():
    first = README.read_text().partition("\n## ")[0]
    for shown in ("**Hazard.**", "**No real arm has been driven by this code yet.**", "rig.webp"):
        assert shown in first
    assert blocks(first, "bash") == ["scripts/record_sim\n"]


def test_contributors_find_the_tests():
    for page in (README, ROOT / "CONTRIBUTING.md"):
        assert "scripts/test\n" in blocks(page.read_text(), "bash")


def test_every_command_has_a_row():
    rows = (ROOT / "docs/README.md").read_text()
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert [name for name in scripts if f"| `{name}` |" not in rows] == []


def test_the_kinds_of_faults_are_counted():
    assert f"finds {len(Kind)} kinds of faults" in README.read_text()


def test_the_python_of_the_quick_start_moves_and_lands_an_arm(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = block(QUICK_START, "python", "YamArm(")
    with running_rig(arms=["follower_left"]) as rig:
        monkeypatch.setenv("YAM_RIG", rig.name)
        names = {}
        exec(code, names)
        motors = rig.state()["arms"]["follower_left"]["motors"].values()
        assert motors and not any(motor["enabled"] for motor in motors)
    seen = [float(number) for number in re.findall(r"-?\d+\.\d*(?:e-?\d+)?", capsys.readouterr().out)]
    assert seen == pytest.approx([0, 1.0, 1.0, 0, 0, 0], abs=0.05)
    assert (tmp_path / names["stops"]).is_file()


def test_any_python_can_program_opens_a_channel_of_the_rig(monkeypatch):
    with running_rig(arms=["follower_left"]) as rig:
        monkeypatch.setenv("YAM_RIG", rig.name)
        names = {}
        exec(block(QUICK_START, "python", "can.Bus("), names)
        with names["bus"] as bus:
            bus.send(can.Message(arbitration_id=0x7FF, data=bytes([1, 0, 0xCC, 0, 0, 0, 0, 0]), is_extended_id=False))
            answer = bus.recv(1.0)
    assert answer is not None and answer.data[0] & 0x0F == 1


@pytest.mark.long
def test_the_doctor_speaks_of_arms_that_are_not_there(tmp_path):
    (command,) = set(re.findall(r"^yam-doctor --config_path=.*", (ROOT / "docs/real-arms.md").read_text(), re.M))
    done = run(command, ROOT)
    assert done.returncode == 1 and "can_follower_l" in done.stdout


@pytest.mark.long
@pytest.mark.timeout(600)
def test_an_installation_without_the_clone_drives_the_rig(tmp_path):
    """What others have made is at hand already; of this package there is nothing but what `pip install .` installs."""
    clone, venv = tmp_path / "clone", tmp_path / "venv"
    shutil.copytree(ROOT, clone, ignore=shutil.ignore_patterns(".*", "outputs", "__pycache__"))
    subprocess.run([sys.executable, "-m", "venv", venv], check=True)
    (packages,) = venv.glob("lib/python*/site-packages")
    (packages / "others.pth").write_text(sysconfig.get_paths()["purelib"])
    environment = os.environ | {"PATH": f"{venv / 'bin'}:{os.environ['PATH']}", "VIRTUAL_ENV": str(venv)}
    environment.pop("PYTHONPATH", None)
    lines = "".join(blocks(section(INSTALLATION, "In an environment of your own"), "bash"))
    lines = lines.replace("pip install .\n", "pip install --ignore-installed --no-deps .\n")
    assert "--no-deps" in lines and "compileall" in lines
    subprocess.run(["bash", "-euc", lines], cwd=clone, env=environment, check=True)
    shutil.move(clone / "my_configs", tmp_path / "my_configs")
    shutil.rmtree(clone)
    copied = tmp_path / "my_configs"
    assert {str(path.relative_to(copied).with_suffix("")) for path in copied.rglob("*.yaml")} == set(config_names())
    where = "import lerobot_robot_yam; print(lerobot_robot_yam.__file__)"
    found = subprocess.run(["python", "-c", where], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert found.stdout.startswith(str(packages))
    command = f"{venv / 'bin' / 'python'} -m lerobot.scripts.lerobot_teleoperate"
    options = "--config_path=my_configs/sim/teleoperate.yaml --teleop_time_s=2"
    done = run(f"{command} {options}", tmp_path, environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "landed" in done.stdout + done.stderr


def run(command, directory, environment=None):
    """One line of a page, its programs those of these tests."""
    search = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    environment = environment or os.environ | search
    return subprocess.run(
        shlex.split(command), cwd=directory, env=environment, capture_output=True, text=True, timeout=300
    )
