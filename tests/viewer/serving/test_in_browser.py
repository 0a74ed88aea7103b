"""The gate in a real browser: the page works behind it, and pages of elsewhere get nothing."""

import contextlib
import functools
import http.server
import threading
import time

import pytest

from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.viewer.live.live import Live
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support.chromium import chromium

pytestmark = pytest.mark.long

ELSEWHERE = """<title>loading</title><iframe id=frame src="{url}"></iframe><script>
const line = new WebSocket("{url}".replace("http", "ws"), ["viser-v1.1.1"])
line.onopen = () => document.title = "in"
line.onerror = () => document.title = "refused"
</script>"""


class _Server(http.server.BaseHTTPRequestHandler):
    """A page of elsewhere."""

    def __init__(self, text, *arguments):
        self._text = text.encode()
        super().__init__(*arguments)

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self._text)

    def log_message(self, *_):
        pass


@contextlib.contextmanager
def page_of_elsewhere(text):
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Server, text))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_the_page_and_pages_of_elsewhere():
    page = Page(port=0, with_token=True)
    with contextlib.closing(page), contextlib.closing(Live(page.server)) as live, chromium() as browser:
        live.update(time.monotonic())
        tab, said = browser.new_page(), []
        tab.on("console", lambda message: said.append(message.text) if message.type in ("error", "warning") else None)
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.goto(page.url)
        button = tab.get_by_role("button", name="EMERGENCY STOP")
        button.wait_for(timeout=60_000)
        assert "token" not in tab.url
        try:
            button.click()
            deadline = time.monotonic() + 10
            while not EmergencyStop().latched and time.monotonic() < deadline:
                time.sleep(0.02)
            assert EmergencyStop().latched
            live.update(time.monotonic())
            tab.get_by_role("button", name="release the emergency stop").click()
            tab.get_by_role("button", name="release", exact=True).click()
            while EmergencyStop().latched and time.monotonic() < deadline:
                time.sleep(0.02)
            assert not EmergencyStop().latched
        finally:
            EmergencyStop().release()
        assert not [text for text in said if "WebGL" not in text and "GPU" not in text], said

        here = tab.url
        with page_of_elsewhere(ELSEWHERE.replace("{url}", here)) as elsewhere:
            other = tab.context.new_page()  # of the same person: it has the cookie
            other.goto(elsewhere)
            other.wait_for_function("document.title != 'loading'", timeout=20_000)
            assert other.title() == "refused"
            frame = other.locator("#frame").element_handle().content_frame()
            assert not frame.get_by_role("button", name="EMERGENCY STOP").count()
            assert frame.url.startswith("chrome-error:")
            assert tab.context.new_page().goto(f"{here}?websocket={elsewhere}").status == 403
