"""The bar over the page: browsers that come later get the newest, and no other."""

import contextlib

import pytest

from lerobot_robot_yam.viewer.live.banner import Banner
from lerobot_robot_yam.viewer.serving.page import Page


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
