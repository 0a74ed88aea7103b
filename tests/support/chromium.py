"""A headless Chromium of the system, driven by Playwright; tests that need it are skipped, aloud, where it is not."""

import contextlib
import shutil

import pytest

FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader")  # root, and no graphics card


@contextlib.contextmanager
def chromium():
    """A browser."""
    playwright = pytest.importorskip("playwright.sync_api", reason='needs Playwright: pip install -e ".[test]"')
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("the page is not tried in a browser: there is no chromium (Debian: apt install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()
