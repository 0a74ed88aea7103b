"""The bar over the page: browsers that come later get the newest, and no other."""

import contextlib

import pytest

from lerobot_robot_yam.viewer.live.live import Banner
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support.browser import browser_page


@pytest.fixture
def page():
    with contextlib.closing(Page(port=0)) as page:
        yield page


def kept(page):
    """The scripts that a browser gets that comes now."""
    messages = page.server._websock_server._broadcast_buffer.message_from_id.values()
    return [message.source for message in messages if type(message).__name__ == "RunJavascriptMessage"]


def test_the_newest_lines_alone_are_kept(page):
    banner = Banner(page.server)
    banner.show(["first"], 1.0)
    banner.show(['second "quoted" </script>'], 1.1)
    (script,) = kept(page)
    assert r"second \"quoted\"" in script and "first" not in script
    banner.show([], 1.2)
    (script,) = kept(page)
    assert "const lines = []" in script


def test_it_is_sent_again_only_as_a_sign_of_life(page):
    banner = Banner(page.server)
    banner.show(["text"], 1.0)
    (first,) = sent = [id(script) for script in kept(page)]
    banner.show(["text"], 1.5)
    assert [id(script) for script in kept(page)] == sent
    banner.show(["text"], 2.1)
    assert id(kept(page)[0]) != first


@pytest.mark.long
def test_nothing_hides_it_and_a_page_that_hears_nothing_says_so(page):
    """In a browser: over a panel that is shut, on top of everything, and by the browser's own clock."""
    errors = []
    Banner(page.server).show(["left: motor silent\nright: motor silent"], 1.0)
    page.server.gui.add_button("a button")
    page.server.gui.main_panel.minimize()
    with browser_page(page.url, errors) as browser:
        bar = browser.locator("#yam-banner")
        bar.get_by_text("right: motor silent").wait_for()
        browser.get_by_role("button", name="a button").wait_for(state="hidden")
        box = bar.bounding_box()
        assert (box["x"], box["y"], box["width"]) == (0, 0, 1280)
        browser.wait_for_function("document.title.startsWith('(!)')")
        bar.get_by_text("NO WORD FROM yam-view").wait_for()
        assert "left: motor silent" in bar.inner_text()
        Banner(page.server).show([], 2.0)
        bar.wait_for(state="hidden")
        assert browser.title() == "yam-view"
    assert not errors
