"""Install this clone and what it needs into the environment whose Python runs this. `scripts/run` calls it.

.venv/bin/python scripts/install.py
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from install_progress import Progress, run_pip
from torch_build import cpu_build, has_nvidia_driver, is_installed

ROOT = Path(__file__).resolve().parent.parent
TARGET = f"{ROOT}[test]"
NO_CPU_BUILD = (
    "this computer has no NVIDIA driver, but your package index has no CPU build of torch. Most of the time and space "
    "goes to a torch for CUDA. To save both, name an index that has a CPU build in PIP_EXTRA_INDEX_URL"
)
_TESTS = r"site-packages/.*/tests?/"  # a fifth of all source that is installed; hardly anything imports it


def main() -> int:
    """Install, compile; returns pip's exit status."""
    with Progress(sys.stderr) as progress, tempfile.TemporaryDirectory() as directory:
        progress.say("installing this package and what it needs (minutes the first time)")
        constraints = Path(directory) / "constraints.txt"
        constraints.write_text("".join(f"{pin}\n" for pin in _torch_pins(progress)))
        arguments = ["install", "--no-compile", f"--constraint={constraints}", f"--editable={TARGET}"]
        status = run_pip(arguments, progress, Path(sys.prefix) / "install.log")
        if status == 0:
            progress.step("compiling byte-code")
            _compile(Path(sys.prefix) / "lib")
            progress.end()
    return status


def _torch_pins(progress: Progress) -> list[str]:
    if is_installed("torch") or not sys.platform.startswith("linux"):
        return []
    if has_nvidia_driver():
        progress.say("this computer has an NVIDIA driver: torch is installed for CUDA, which is most of the download")
        return []
    progress.step("looking for a CPU build of torch")
    pins = cpu_build(TARGET)
    progress.say(f"no NVIDIA driver here: the CPU build {pins[0]} will do" if pins else NO_CPU_BUILD)
    return pins


def _compile(directory: Path) -> None:
    """Also where PYTHONDONTWRITEBYTECODE is set: without byte-code every LeRobot command takes seconds longer."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([sys.executable, "-m", "compileall", "-q", "-j", "0", "-x", _TESTS, str(directory)], env=environment)


if __name__ == "__main__":
    sys.exit(main())
