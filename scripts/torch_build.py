"""Which build of torch to install: on Linux the default is for CUDA, gigabytes that only NVIDIA's driver uses."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

_DRIVER = ("/proc/driver/nvidia/version", "/dev/nvidiactl", "/dev/nvmap", "/dev/dxg")  # the last two: Jetson, WSL
_PACKAGES = ("torch", "torchvision")  # built for each other


def has_nvidia_driver() -> bool:
    """Whether this computer can use CUDA."""
    return any(Path(path).exists() for path in _DRIVER) or shutil.which("nvidia-smi") is not None


def is_installed(package: str) -> bool:
    """Whether this environment has a package."""
    return importlib.util.find_spec(package) is not None


def cpu_build(target: str) -> list[str]:
    """Pins of the CPU builds of what pip would install for `target`; none unless the user's own index has them all.

    Args:
        target: as pip takes it: a path with extras.
    """
    offered = {package: _cpu_versions(package) for package in _PACKAGES}
    if not all(offered.values()):
        return []
    pins = []
    for package, version in _resolved(target).items():
        cpu = f"{version.partition('+')[0]}+cpu"
        if cpu not in offered[package]:
            return []
        pins.append(f"{package}=={cpu}")
    return pins


def _cpu_versions(package: str) -> set[str]:
    """CPU builds of a package for this Python and platform in the configured index."""
    return set(re.findall(r"[\w.]+\+cpu\b", _pip("index", "versions", package)))


def _resolved(target: str) -> dict[str, str]:
    """The versions that pip would install."""
    text = _pip("install", "--quiet", "--dry-run", "--report=-", f"--editable={target}")
    planned = {item["metadata"]["name"]: item["metadata"]["version"] for item in json.loads(text or "{}")["install"]}
    return {package: planned[package] for package in _PACKAGES if package in planned}


def _pip(*arguments: str) -> str:
    """What pip prints; nothing where it fails, which the installation itself will tell."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    return done.stdout if done.returncode == 0 else ""
