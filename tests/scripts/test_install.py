"""The installation of a clone, from an index of tiny wheels: which torch it takes, what it shows, what it refuses."""

import json
import os
import shutil
import subprocess
import sys
import zipfile

import pytest

from tests.support.paths import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

import install  # noqa: E402
from install import has_nvidia_driver, run_pip  # noqa: E402

PROJECT = """
[build-system]
requires = []
build-backend = "backend"
backend-path = ["."]

[project]
name = "toy"
version = "1.0"
"""
BACKEND = """
import zipfile
INFO = "toy-1.0.dist-info"
TEXT = "Metadata-Version: 2.1\\nName: toy\\nVersion: 1.0\\nProvides-Extra: test\\n"
TEXT += "Requires-Dist: torch<2.12,>=2.7\\nRequires-Dist: torchvision\\n"

def build_editable(directory, config_settings=None, metadata_directory=None):
    with zipfile.ZipFile(f"{directory}/toy-1.0-py3-none-any.whl", "w") as file:
        file.writestr(f"{INFO}/METADATA", TEXT)
        file.writestr(f"{INFO}/WHEEL", "Wheel-Version: 1.0\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n")
        file.writestr(f"{INFO}/RECORD", "")
    return "toy-1.0-py3-none-any.whl"
"""
TORCHES = {"2.10.0": "0.25.0", "2.11.0": "0.26.0", "2.12.0": "0.27.0"}  # and the torchvision for each


def write_wheel(directory, name, version, requires=()):
    """A distribution whose one module knows its version."""
    info = f"{name}-{version}.dist-info"
    with zipfile.ZipFile(directory / f"{name}-{version}-py3-none-any.whl", "w") as file:
        file.writestr(f"{name}.py", f"__version__ = {version!r}\n")
        needs = "".join(f"Requires-Dist: {need}\n" for need in requires)
        file.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{needs}")
        file.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        file.writestr(f"{info}/RECORD", "")


@pytest.fixture
def index(tmp_path, monkeypatch):
    """Gives pip an index of torches in these builds, and nothing else."""
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    for name in [name for name in os.environ if name.startswith("PIP_")]:
        monkeypatch.delenv(name)
    for name, value in {"CONFIG_FILE": os.devnull, "NO_INDEX": "1", "FIND_LINKS": str(wheels)}.items():
        monkeypatch.setenv(f"PIP_{name}", value)

    def offer(*builds):
        for torch, torchvision in TORCHES.items():
            for build in builds:
                write_wheel(wheels, "torch", torch + build)
                write_wheel(wheels, "torchvision", torchvision + build, [f"torch=={torch}"])

    return offer


@pytest.fixture
def clone(tmp_path):
    """A clone of a project that needs torch, with our scripts."""
    root = tmp_path / "clone"
    (root / "scripts").mkdir(parents=True)
    for name in ("run", "install.py"):
        shutil.copy(ROOT / "scripts" / name, root / "scripts")
    for package in ("lerobot_robot_yam", "lerobot_strategy_yam", "lerobot_teleoperator_yam"):
        (root / package).mkdir()
    (root / "pyproject.toml").write_text(PROJECT)
    (root / "backend.py").write_text(BACKEND)
    return root


def run(clone, *command):
    return subprocess.run(["scripts/run", *command], cwd=clone, capture_output=True, text=True, timeout=120)


SAY = ("python", "-c", "import torch, torchvision; print(torch.__version__, torchvision.__version__)")
without_driver = pytest.mark.skipif(has_nvidia_driver(), reason="this computer has an NVIDIA driver")


@pytest.mark.long
@without_driver
def test_without_nvidias_driver_the_cpu_build_is_installed_once_and_kept(index, clone):
    index("", "+cpu", "+cu130")
    done = run(clone, *SAY)
    assert done.stdout.split() == ["2.11.0+cpu", "0.26.0+cpu"], done.stderr
    said = done.stderr.splitlines()
    assert (
        "torch==2.11.0+cpu" in done.stderr and len(said) < 12 and all(line.startswith("scripts/run: ") for line in said)
    )
    assert list((clone / ".venv").glob("lib/python*/site-packages/__pycache__/torch.*.pyc"))
    again = run(clone, *SAY)
    assert again.stdout == done.stdout and not again.stderr
    (packages,) = (clone / ".venv").glob("lib/python*/site-packages")
    (packages / "lerobot_robot_yam").mkdir()
    (packages / "lerobot_robot_yam" / "__init__.py").touch()  # as if it came from the package index
    refused = run(clone, *SAY)
    assert (
        refused.returncode == 1 and "another project's package" in refused.stderr and "pip uninstall" in refused.stderr
    )


@pytest.mark.long
@without_driver
def test_an_index_without_a_cpu_build_is_spoken_of(index, clone):
    index("")
    done = run(clone, *SAY)
    assert done.stdout.split() == ["2.11.0", "0.26.0"], done.stderr
    assert "no CPU build of torch" in done.stderr and "PIP_EXTRA_INDEX_URL" in done.stderr


def test_with_nvidias_driver_torch_is_for_cuda(tmp_path, monkeypatch, capsys):
    (tmp_path / "nvidia-smi").write_text("#!/bin/sh\n")
    (tmp_path / "nvidia-smi").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(install.importlib.util, "find_spec", lambda name: None)
    assert install._torch_pins() == [] and "NVIDIA driver: torch is installed for CUDA" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("vision", "pins"), [("0.26.0+cpu", ["torch==2.11.0+cpu", "torchvision==0.26.0+cpu"]), ("0.25.0+cpu", [])]
)
def test_torch_is_for_cpus_only_if_torchvision_is(monkeypatch, vision, pins):
    """What pip says stands here; the tests of the long tier run pip."""
    planned = [{"metadata": {"name": n, "version": v}} for n, v in (("torch", "2.11.0"), ("torchvision", "0.26.0"))]
    offered = {"torch": "2.11.0+cpu, 2.10.0+cpu", "torchvision": vision}
    said = {"index": lambda name: offered[name], "install": lambda *_: json.dumps({"install": planned})}
    monkeypatch.setattr(install, "_pip", lambda what, *words: said[what](words[-1]))
    assert install.cpu_build(".") == pins


@pytest.mark.long
def test_what_cannot_be_installed_is_said_in_full(index, clone):
    done = run(clone, "true")
    assert done.returncode != 0 and not (clone / ".venv" / "installed").exists()
    assert "No matching distribution found for torch" in done.stderr
    assert f"{clone}/.venv/install.log" in done.stderr


PIP_SAYS = """
import sys, time
print("Collecting torch<2.12,>=2.7 (from x)")
print("  Downloading torch-2.11.0-cp312-cp312-manylinux_2_28_x86_64.whl.metadata (30 kB)")
print("Downloading nvidia_cublas-13.1.0.3-py3-none-manylinux_2_27_x86_64.whl (1.5 GB)")
for n in range(200):
    print(f"Downloading small_{n}-1.0-py3-none-any.whl ({n} kB)")
for n in range(50):
    print(f"WARNING: place {n} is ignored", file=sys.stderr)
print("Installing collected packages: torch, small_1, small_2")
sys.exit(int(sys.argv[-1]))
"""


def test_pip_is_followed_without_a_line_for_every_package(tmp_path, monkeypatch, capsys):
    (tmp_path / "pip").mkdir()
    (tmp_path / "pip" / "__init__.py").touch()
    (tmp_path / "pip" / "__main__.py").write_text(PIP_SAYS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert run_pip(["0"], tmp_path / "log") == 0
    shown = capsys.readouterr().err
    assert "downloading nvidia_cublas 13.1.0.3 (1500 MB)" in shown and "unpacking 3 packages" in shown
    assert len(shown.splitlines()) < 5 and len((tmp_path / "log").read_text().splitlines()) > 200
    assert run_pip(["1"], tmp_path / "log") == 1
    assert "Installing collected packages" in capsys.readouterr().err
