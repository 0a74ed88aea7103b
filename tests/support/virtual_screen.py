"""A screen without a monitor: Xvfb of the system."""

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator

import pytest


@contextlib.contextmanager
def virtual_screen(size: str = "640x480x8") -> Iterator[dict[str, str]]:
    """Yields the environment of programs that are to use it; where there is no Xvfb the test is skipped, aloud.

    size: width x height x bits of a pixel.
    """
    if shutil.which("Xvfb") is None:
        pytest.skip("what needs a screen is not tested: there is no Xvfb (Debian: apt install xvfb)")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", size, "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with open(read) as numbers:
            environment = os.environ | {"DISPLAY": f":{numbers.readline().strip()}"}
        for name in ("WAYLAND_DISPLAY", "XDG_SESSION_TYPE"):
            environment.pop(name, None)
        yield environment
    finally:
        server.terminate()
        server.wait()
