"""A page in a real headless Chromium."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, sync_playwright

CHROMIUM = Path("/usr/bin/chromium")  # Debian's
_OPTIONS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--disable-dev-shm-usage"]


class OpenPage(Page):
    """Playwright's page. `errors`: what its console and its scripts have complained of."""

    errors: list[str]


@contextlib.contextmanager
def browser_page(url: str, width: int = 1280, height: int = 900) -> Iterator[OpenPage]:
    """The page at a URL, once it is loaded; its browser ends with the block."""
    if not CHROMIUM.exists():
        pytest.skip("needs Debian's chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=_OPTIONS)
        try:
            page = browser.new_page(viewport={"width": width, "height": height})
            page.errors = []
            page.on("console", lambda said: page.errors.append(said.text) if said.type == "error" else None)
            page.on("pageerror", lambda error: page.errors.append(str(error)))
            page.goto(url)
            yield page
        finally:
            browser.close()
