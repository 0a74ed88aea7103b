"""The server itself: who gets in, what closes a connection, how much it takes, and what the terminal says of it."""

import contextlib
import http.client
import logging
import socket
import time

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.viewer.serving.guarded_server import Seldom, logger
from lerobot_robot_yam.viewer.serving.page import Page
from tests.viewer.serving.test_incoming import CAMERA

VERSION = f"viser-v{viser.__version__}"
POLICY_VIOLATION, TOO_BIG = 1008, 1009


@pytest.fixture
def page():
    page = Page(port=0)
    yield page
    page.close()


@pytest.fixture
def public_page():
    """As others see it: on all addresses, with a token."""
    page = Page("0.0.0.0", 0)
    yield page
    page.close()


def port_of(page):
    return page.server.get_port()


def browser(page, **options):
    """A WebSocket as viser's page opens it."""
    options = {"subprotocols": [VERSION], "origin": f"http://127.0.0.1:{port_of(page)}"} | options
    return connect(f"ws://127.0.0.1:{port_of(page)}", max_size=None, **options)


def get(page, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port_of(page), timeout=10)
    with contextlib.closing(connection):
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


def answers(page):
    """The page is served, and a WebSocket is told something."""
    assert get(page)[0] == 200
    with browser(page) as socket_:
        socket_.send(msgspec.msgpack.encode(CAMERA))
        return len(socket_.recv(timeout=10)) > 0


def test_it_listens_on_this_computer_only(page):
    others = [a[4][0] for a in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)]
    assert page.url == f"http://127.0.0.1:{port_of(page)}"
    assert answers(page)
    for address in {"127.0.0.2", *others} - {"127.0.0.1"}:
        with pytest.raises(OSError):
            socket.create_connection((address, port_of(page)), timeout=2).close()


@pytest.mark.parametrize(
    "options",
    [
        {"origin": "http://evil.example"},
        {"origin": "http://127.0.0.1:1"},
        {"origin": "null"},
        {"additional_headers": {"Host": "evil.example"}},
        {"subprotocols": ["viser-v0.0.1"]},
        {"subprotocols": None},
    ],
)
def test_websockets_of_others(page, options):
    with pytest.raises(InvalidStatus) as refused:
        browser(page, **options)
    assert refused.value.response.status_code in (403, 426)


@pytest.mark.parametrize(
    "path, status",
    [
        ("/", 200),
        ("/index.html", 200),
        ("/../../../../etc/passwd", 404),
        ("/%2e%2e/%2e%2e/%2e%2e/etc/passwd", 404),
        ("/..%5c..%5cetc%5cpasswd", 404),
        ("//etc/passwd", 404),
        ("/%00", 404),
        ("/" + 5000 * "a", 404),
        ("/?websocket=ws://evil.example", 403),
    ],
)
def test_paths(page, path, status):
    found, headers, body = get(page, path)
    assert found == status and b"root:" not in body
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"] and headers["X-Frame-Options"] == "DENY"


def test_tokens(public_page):
    token = public_page.url.partition("?token=")[2]
    assert len(token) >= 32 and socket.gethostname() in public_page.url
    assert get(public_page)[0] == get(public_page, "/?token=wrong")[0] == 403
    status, headers, body = get(public_page, f"/?token={token}")
    assert status == 303 and token not in body.decode()
    cookie = headers["Set-Cookie"].partition(";")[0]
    assert get(public_page, Cookie=cookie)[0] == 200
    for wrong in ({}, {"Cookie": f"{cookie}x"}):
        with pytest.raises(InvalidStatus):
            browser(public_page, additional_headers=wrong)
    with pytest.raises(InvalidStatus):
        browser(public_page, additional_headers={"Cookie": cookie}, origin="http://evil.example")
    with browser(public_page, additional_headers={"Cookie": cookie}) as admitted:
        assert admitted.recv(timeout=10)


def test_a_token_on_this_computer():
    page = Page(port=0, with_token=True)
    with contextlib.closing(page):
        assert get(page)[0] == 403 and get(page, page.url.partition(str(port_of(page)))[2])[0] == 303


@pytest.mark.parametrize(
    "sent, code",
    [
        (b"\xc1", POLICY_VIOLATION),
        ("text", POLICY_VIOLATION),
        (msgspec.msgpack.encode({"type": "NoSuchMessage"}), POLICY_VIOLATION),
        (bytes(70_000), TOO_BIG),
    ],
)
def test_a_malformed_message_closes_its_connection_alone(page, sent, code):
    with browser(page) as other, browser(page) as bad:
        bad.send(sent)
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                bad.recv(timeout=10)
        assert closed.value.rcvd.code == code
        other.send(msgspec.msgpack.encode(CAMERA))
        assert other.recv(timeout=10)
    assert answers(page)


def test_no_tunnel_is_opened(page, monkeypatch):
    asked = []
    monkeypatch.setattr(viser.ViserServer, "request_share_url", lambda *_, **__: asked.append(True))
    clicked = []
    button = page.server.gui.add_button("a button")
    button.on_click(lambda _: clicked.append(True))
    with browser(page) as socket_:
        socket_.send(msgspec.msgpack.encode(CAMERA))
        socket_.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
        click = {"type": "GuiUpdateMessage", "uuid": button._impl.uuid, "updates": {"value": True}}
        deadline = time.monotonic() + 10
        while not clicked and time.monotonic() < deadline:
            socket_.send(msgspec.msgpack.encode(click))
            time.sleep(0.05)
    assert clicked and not asked


def test_many_connections(page):
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(browser(page))
        for _ in range(300):  # that say nothing
            stack.enter_context(contextlib.closing(socket.create_connection(("127.0.0.1", port_of(page)))))
        first.send(msgspec.msgpack.encode(CAMERA))
        assert first.recv(timeout=10)
    assert answers(page)
    with contextlib.ExitStack() as stack:
        opened, refused = 0, 0
        for _ in range(50):
            try:
                stack.enter_context(browser(page))
                opened += 1
            except InvalidStatus as error:
                assert error.response.status_code == 503
                refused += 1
        assert opened >= 30 and refused >= 10
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        with contextlib.suppress(InvalidStatus):
            assert answers(page)
            return
        time.sleep(0.1)
    raise AssertionError("no page can be opened once the others have gone")


def test_the_terminal_is_not_flooded(page, caplog):
    with caplog.at_level(logging.WARNING, logger.name):
        for _ in range(20):
            with browser(page) as bad, contextlib.suppress(ConnectionClosed):
                bad.send(b"\xc1")
                while True:
                    bad.recv(timeout=10)
    said = [record for record in caplog.records if record.name == logger.name]
    assert len(said) <= 2 and not any(record.exc_info for record in said)


def test_what_was_left_out_is_counted():
    seldom = Seldom()
    record = logging.makeLogRecord({"msg": "no %s", "args": ("token",)})
    assert not seldom.filter(logging.makeLogRecord({"msg": "opening handshake failed"}))  # a browser's habit
    assert seldom.filter(record) and record.getMessage() == "no token"
    assert not any(seldom.filter(logging.makeLogRecord({"msg": "again"})) for _ in range(3))
    seldom._said_s -= 100.0
    try:
        raise ValueError("x" * 1000)
    except ValueError as error:
        again = logging.makeLogRecord({"msg": "again", "exc_info": (type(error), error, error.__traceback__)})
    assert seldom.filter(again)
    assert again.getMessage().endswith("(and 3 more like this)") and again.exc_info is None
    assert len(again.getMessage()) < 300


@pytest.mark.parametrize("host, port", [("203.0.113.7", 8080), ("127.0.0.1", 70_000), ("127.0.0.1", -200)])
def test_where_nobody_can_listen(host, port):
    with pytest.raises(ConfigError, match="cannot listen"):
        Page(host, port)


def test_a_port_that_is_taken(page):
    with contextlib.closing(Page(port=port_of(page))) as other:
        assert port_of(other) > port_of(page)
