"""yam-view as a user runs it, and pages of it in a real headless Chromium of the system, driven by Playwright."""

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

if TYPE_CHECKING:
    from playwright.sync_api import Page

# As root, without a graphics card, with little shared memory.
_OPTIONS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--disable-dev-shm-usage"]
_COLOURS = 256  # of a picture: enough for a page, in a third of the size
_PATIENCE_MS = 60_000  # of a browser that draws without a graphics card on a busy machine
_END_S = 15.0  # from Ctrl-C to the end: arms land at 0.6 rad/s, which takes 5 s


PATIENT_S = 10.0  # that a page may be silent in tests: without a graphics card a browser answers too seldom
_PATIENT = f"""
import sys
from lerobot_robot_yam.commands.pages.view import main
from lerobot_robot_yam.viewer.moving import heartbeat
heartbeat.SILENT_S = heartbeat.OLD_S = {PATIENT_S}
sys.exit(main(sys.argv[1:]))
"""


@contextlib.contextmanager
def yam_view(*arguments: str, patient: bool = False) -> Iterator[str]:
    """Run `yam-view` on a free port; yields the address that it prints. It ends by Ctrl-C.

    patient: a browser keeps its control for PATIENT_S without an answer.
    """
    program = ["-c", _PATIENT] if patient else ["-m", "lerobot_robot_yam.commands.pages.view"]
    command = [sys.executable, *program, "--port", "0", *arguments]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        said = process.stderr.readline()
        assert said.startswith("open http"), said + process.stderr.read()
        yield said.split()[1]
    finally:
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=_END_S)
    assert process.returncode == 130 and "Traceback" not in said, said


@contextlib.contextmanager
def browser_page(url: str, errors: list[str], width: int = 1280, height: int = 900) -> Iterator["Page"]:
    """A page in a browser of its own; `errors` collects what its console and its scripts complain of.

    Where there is no browser the test is skipped, aloud.
    """
    playwright = pytest.importorskip(
        "playwright.sync_api", reason='needs Playwright: pip install -e ".[test]" in the clone'
    )
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("the page is not tried in a browser: there is no chromium (Debian: apt install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=_OPTIONS)
        try:
            page = browser.new_page(viewport={"width": width, "height": height})
            page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.set_default_timeout(_PATIENCE_MS)
            page.goto(url)
            yield page
        finally:
            browser.close()


def take_picture(page: "Page", directory: Path) -> Image.Image:
    """What a page shows, written as `keep_picture` says."""
    warning = page.locator(".mantine-Notification-root", has_text="Software WebGL")
    if warning.is_visible():
        warning.get_by_role("button").click()
        warning.wait_for(state="detached")
    return keep_picture(Image.open(io.BytesIO(page.screenshot())), directory)


def keep_picture(picture: Image.Image, directory: Path) -> Image.Image:
    """Write a picture to this directory, or with YAM_DOCS_PICTURE=PATH to where docs/ have it; returns it in RGB."""
    path, picture = Path(os.environ.get("YAM_DOCS_PICTURE") or directory / "page.png"), picture.convert("RGB")
    picture.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
    assert np.asarray(picture.convert("L")).std() > 10.0, "a page of one colour"
    return picture
