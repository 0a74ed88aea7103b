"""The gate in a real browser: the page works behind it, and pages of elsewhere get nothing."""

import contextlib
import functools
import http.server
import threading
import time

import pytest
import viser

from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.viewer.live.live import Live
from lerobot_robot_yam.viewer.serving.page import Page
from tests.support.browser import chromium

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

_PATIENCE_MS = 120_000  # a page is drawn without a graphics card

ELSEWHERE = """<title>loading</title><iframe id=frame src="{url}"></iframe><script>
const line = new WebSocket("{url}".replace("http", "ws"), ["viser-v{version}"])
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


def test_the_page_works_behind_the_gate():
    page = Page(port=0, with_token=True)
    with contextlib.closing(page), contextlib.closing(Live(page.server)) as live, chromium() as browser:
        live.update(time.monotonic())
        tab, said = browser.new_page(), []
        tab.set_default_timeout(_PATIENCE_MS)
        tab.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.goto(page.url)
        try:
            tab.get_by_role("button", name="EMERGENCY STOP").click()
            deadline = time.monotonic() + 10
            while not EmergencyStop().latched and time.monotonic() < deadline:
                time.sleep(0.02)
            assert EmergencyStop().latched
        finally:
            EmergencyStop().release()
        assert "token" not in tab.url and not said


def test_pages_of_elsewhere_get_nothing():
    page = Page(port=0, with_token=True)
    with contextlib.closing(page), chromium() as browser:
        person = browser.new_context()
        person.set_default_timeout(_PATIENCE_MS)
        tab = person.new_page()
        tab.goto(page.url, wait_until="commit")
        here = tab.url
        tab.close()
        assert "token" not in here and len(person.cookies()) == 1
        with page_of_elsewhere(ELSEWHERE.replace("{url}", here).replace("{version}", viser.__version__)) as elsewhere:
            other = person.new_page()
            other.goto(elsewhere)
            other.wait_for_function("document.title != 'loading'")
            assert other.title() == "refused"
            assert other.locator("#frame").element_handle().content_frame().url.startswith("chrome-error:")
            assert other.goto(f"{here}?websocket={elsewhere}").status == 403
