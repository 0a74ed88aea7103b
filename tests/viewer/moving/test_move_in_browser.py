"""The page in a real browser: a person connects an arm, moves it by a slider, and closes the tab."""

from pathlib import Path

import pytest

from tests.viewer.moving import test_move_command
from tests.viewer.moving.test_move_command import enabled, q1, wait

CHROMIUM = Path("/usr/bin/chromium")
pytestmark = [
    pytest.mark.long,
    pytest.mark.alone,
    pytest.mark.skipif(not CHROMIUM.exists(), reason="needs Debian's chromium"),
]

rig, page = test_move_command.rig, test_move_command.page


@pytest.fixture
def chromium():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        options = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=options)
        yield browser
        browser.close()


def test_an_arm_moves_by_its_slider_and_holds_when_the_tab_is_closed(rig, page, chromium):
    tab = chromium.new_page()
    errors = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(f"http://127.0.0.1:{page.port}")
    thumb = tab.get_by_role("slider").first
    thumb.focus()
    thumb.press("End")
    tab.get_by_text("nothing was done: the arms are not connected").first.wait_for()
    assert not enabled(rig)
    tab.get_by_role("button", name="connect …").click()
    tab.get_by_role("button", name="energise").click()
    tab.get_by_text("the arms hold where they are").first.wait_for()
    tab.get_by_role("button", name="take control").click()
    tab.get_by_text("controls the arms").first.wait_for()
    thumb.focus()
    thumb.press("End")
    wait(lambda: q1(rig) > 1.0)
    tab.close()
    tab = chromium.new_page()
    tab.goto(f"http://127.0.0.1:{page.port}")
    tab.get_by_text("ENABLED").first.wait_for()
    assert 1.0 < q1(rig) < 2.5 and len(enabled(rig)) == 7
    assert not errors
