"""The loop of the page: a part that fails is told of, and ends neither the others nor the page."""

import contextlib

import pytest

from lerobot_robot_yam.viewer.live.live import Live
from lerobot_robot_yam.viewer.serving.page import Page

ROUNDS = 4


class Broken:
    def update(self, now_s):
        raise ValueError("a defect")


class Ending:
    """Ends the page after some rounds, as Ctrl-C does."""

    rounds = 0

    def update(self, now_s):
        self.rounds += 1
        if self.rounds == ROUNDS:
            raise KeyboardInterrupt


def test_a_part_that_fails_is_named_by_the_banner_and_the_log_and_the_others_go_on(caplog):
    with contextlib.closing(Page(port=0)) as page:
        live, ending = Live(page.server, page.troubles), Ending()
        with contextlib.closing(live), pytest.raises(KeyboardInterrupt):
            page.run([live, Broken(), ending])
        sent = page.server._websock_server._broadcast_buffer.message_from_id.values()
        (script,) = [message.source for message in sent if type(message).__name__ == "RunJavascriptMessage"]
    assert ending.rounds == ROUNDS
    assert "A PART OF THIS PAGE HAS FAILED, Broken" in script
    (record,) = [record for record in caplog.records if "Broken" in record.getMessage()]
    assert "a defect" in str(record.exc_info[1])
