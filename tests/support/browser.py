"""yam-view as a user runs it, and a page of it in a real headless Chromium."""

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, sync_playwright

CHROMIUM = Path("/usr/bin/chromium")  # Debian's
_OPTIONS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--disable-dev-shm-usage"]

_PATIENCE_MS = 60_000  # of a browser that draws without a graphics card on a busy machine


@contextlib.contextmanager
def yam_view(*arguments: str) -> Iterator[str]:
    """Run `yam-view` on a free port; yields the address that it prints. It ends by Ctrl-C."""
    command = [sys.executable, "-m", "lerobot_robot_yam.commands.view", "--port", "0", *arguments]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        said = process.stderr.readline()
        assert said.startswith("open http"), said + process.stderr.read()
        yield said.split()[1]
    finally:
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=20)
    assert process.returncode == 130 and "Traceback" not in said, said


@contextlib.contextmanager
def browser_page(url: str, errors: list[str], width: int = 1280, height: int = 900) -> Iterator[Page]:
    """A browser at a URL; `errors` collects what its console and its scripts complain of."""
    if not CHROMIUM.exists():
        pytest.skip("needs Debian's chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=_OPTIONS)
        try:
            page = browser.new_page(viewport={"width": width, "height": height})
            page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.set_default_timeout(_PATIENCE_MS)
            page.goto(url)
            yield page
        finally:
            browser.close()
