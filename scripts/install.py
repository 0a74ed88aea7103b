"""Install this clone and its dependencies into the environment of the running Python. `scripts/run` calls this script.

.venv/bin/python scripts/install.py

On Linux the default build of torch is for CUDA: gigabytes that only NVIDIA's driver can use. Without this driver, the
CPU build is installed if the user's package index offers one.
"""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TARGET = f"{ROOT}[test]"
NO_CPU_BUILD = (
    "this computer has no NVIDIA driver, but your package index has no CPU build of torch. Most of the time and space "
    "goes to a torch for CUDA. To save both, name an index that has a CPU build in PIP_EXTRA_INDEX_URL"
)
_IMPORT_COMMANDS = """
import contextlib, importlib.metadata
for command in importlib.metadata.entry_points(group="console_scripts"):
    if command.dist.name in ("lerobot", "lerobot_robot_yam"):
        with contextlib.suppress(Exception, SystemExit):  # one that needs an extra which is not installed
            command.load()
"""
_DRIVER = ("/proc/driver/nvidia/version", "/dev/nvidiactl", "/dev/nvmap", "/dev/dxg")  # the last two: Jetson, WSL
_PACKAGES = ("torch", "torchvision")  # their versions must match
_PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
_DOWNLOAD = re.compile(r"Downloading (?:\S*/)?(\S+?)-(\d\S*?)-\S*\.whl \(([\d.]+) (MB|GB)\)")
_INSTALL = re.compile(r"Installing collected packages: (.*)")
_LARGE_MB = 20.0  # downloads of at least this size are shown
_TAIL = 30  # number of pip's last lines shown if pip fails without an error message
_begun_s = time.monotonic()


def main() -> int:
    """Install and compile; return pip's exit status."""
    say("installing this package and what it needs (minutes the first time)")
    with tempfile.TemporaryDirectory() as directory:
        constraints = Path(directory) / "constraints.txt"
        constraints.write_text("".join(f"{pin}\n" for pin in _torch_pins()))
        arguments = ["install", "--no-compile", f"--constraint={constraints}", f"--editable={TARGET}"]
        status = run_pip(arguments, Path(sys.prefix) / "install.log")
    if status == 0:
        say("compiling byte-code")
        _compile()
        say("installed")
    return status


def say(text: str) -> None:
    """Print a line with the time since the start."""
    seconds = int(time.monotonic() - _begun_s)
    print(f"scripts/run: {seconds // 60}:{seconds % 60:02d}  {text}", file=sys.stderr, flush=True)


def run_pip(arguments: list[str], log: Path) -> int:
    """Run pip, show large steps and errors, and log the whole output to a file; return pip's exit status."""
    lines: list[str] = []
    failed = False
    with (
        open(log, "w") as file,
        subprocess.Popen(
            [*_PIP, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
        ) as pip,
    ):
        assert pip.stdout is not None
        for line in pip.stdout:
            file.write(line)
            lines.append(line.rstrip())
            failed = failed or line.lstrip().lower().startswith("error")
            if failed:
                say(lines[-1])
            elif found := _DOWNLOAD.search(line):
                size_mb = float(found[3]) * {"MB": 1.0, "GB": 1e3}[found[4]]
                if size_mb >= _LARGE_MB:
                    say(f"downloading {found[1]} {found[2]} ({size_mb:.0f} MB)")
            elif found := _INSTALL.search(line):
                say(f"unpacking {found[1].count(',') + 1} packages")
    if pip.returncode:
        for line in [] if failed else lines[-_TAIL:]:
            say(line)
        say(f"the installation has failed; all that pip has said is in {log}")
    return pip.returncode


def has_nvidia_driver() -> bool:
    """Return whether this computer can use CUDA."""
    return any(Path(path).exists() for path in _DRIVER) or shutil.which("nvidia-smi") is not None


def _torch_pins() -> list[str]:
    if importlib.util.find_spec("torch") is not None or not sys.platform.startswith("linux"):
        return []
    if has_nvidia_driver():
        say("this computer has an NVIDIA driver: torch is installed for CUDA, which is most of the download")
        return []
    pins = cpu_build(TARGET)
    say(f"no NVIDIA driver here: the CPU build {pins[0]} will do" if pins else NO_CPU_BUILD)
    return pins


def cpu_build(target: str) -> list[str]:
    """Return pins of the CPU builds that `target` needs; empty unless the user's index offers all of them.

    Args:
        target: as for pip: a path with extras.
    """
    # CPU builds for this Python and platform in the configured index.
    offered = {name: set(re.findall(r"[\w.]+\+cpu\b", _pip("index", "versions", name))) for name in _PACKAGES}
    if not all(offered.values()):
        return []
    report = json.loads(_pip("install", "--quiet", "--dry-run", "--report=-", f"--editable={target}") or "{}")
    planned = {item["metadata"]["name"]: item["metadata"]["version"] for item in report["install"]}
    cpu = {name: f"{planned[name].partition('+')[0]}+cpu" for name in _PACKAGES if name in planned}
    return [f"{name}=={cpu[name]}" for name in cpu] if all(cpu[name] in offered[name] for name in cpu) else []


def _pip(*arguments: str) -> str:
    """Return pip's output; empty if pip fails, which the installation itself will report."""
    done = subprocess.run([*_PIP, *arguments], capture_output=True, text=True)
    return done.stdout if done.returncode == 0 else ""


def _compile() -> None:
    """Cache the byte-code of all modules that the commands import, even if PYTHONDONTWRITEBYTECODE is set.

    Without cached byte-code each LeRobot command takes seconds longer. Compiling all packages would take three times
    as long.
    """
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([sys.executable, "-c", _IMPORT_COMMANDS], env=environment, stderr=subprocess.DEVNULL)


if __name__ == "__main__":
    sys.exit(main())
