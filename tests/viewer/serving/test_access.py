"""Who may reach the page, as a table: address, headers and path of a request, and what becomes of it."""

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.viewer.serving.access import Access, is_loopback

TOKEN = "s3cret"
HERE, ABROAD = "127.0.0.1", "0.0.0.0"


def request(path="/", *headers):
    return Request(path, Headers(headers))


def cookie_of(access):
    welcome = access.answer(request(f"/?token={TOKEN}", ("Host", "robot:8080")))
    return welcome.headers["Set-Cookie"].partition(";")[0]


@pytest.mark.parametrize(
    "headers, admitted",
    [
        ([("Host", "127.0.0.1:8080")], True),
        ([("Host", "localhost:9000")], True),  # through ssh, from another port
        ([("Host", "LOCALHOST:9000")], True),
        ([("Host", "[::1]:8080")], True),
        ([("Host", "127.0.0.5:8080")], True),  # which `--host` takes
        ([("Host", "127.0.0.5.evil.example")], False),
        ([("Host", "evil.example:8080")], False),  # a name that was made to lead here
        ([("Host", "127.0.0.1.evil.example")], False),
        ([("Host", "")], False),
        ([("Host", "me@localhost")], False),
        ([("Host", "localhost/there")], False),
        ([("Host", "localhost; script-src *")], False),
        ([], False),
        ([("Host", "[::1")], False),
        ([("Host", "127.0.0.1"), ("Host", "localhost")], False),
        ([("Host", "127.0.0.1:8080"), ("Origin", "http://127.0.0.1:8080")], True),
        ([("Host", "127.0.0.1:8080"), ("Origin", "http://localhost:8080")], False),
        ([("Host", "127.0.0.1:8080"), ("Origin", "http://127.0.0.1:9999")], False),
        ([("Host", "127.0.0.1:8080"), ("Origin", "https://evil.example")], False),
        ([("Host", "127.0.0.1:8080"), ("Origin", "null")], False),
        ([("Host", "127.0.0.1:8080"), ("Origin", "")], False),
        ([("Host", "127.0.0.1:8080"), ("Origin", "http://[")], False),
        ([("Host", "127.0.0.1"), ("Origin", "http://127.0.0.1"), ("Origin", "http://evil.example")], False),
    ],
)
def test_names_and_origins_on_this_computer(headers, admitted):
    answer = Access(HERE, None).answer(request("/", *headers))
    assert (answer is None) == admitted
    assert admitted or answer.status_code == 403


@pytest.mark.parametrize("path", ["/?websocket=wss://evil.example", "/?playbackPath=http://evil.example/a"])
def test_options_of_the_client_are_refused(path):
    assert Access(HERE, None).answer(request(path, ("Host", "localhost"))).status_code == 403


@pytest.mark.parametrize(
    "path, cookie, status",
    [
        ("/", None, 403),
        ("/?token=", None, 403),
        ("/?token=wrong", None, 403),
        (f"/?token={TOKEN}x", None, 403),
        (f"/?token={TOKEN[:-1]}", None, 403),
        ("/?token=%ff%fe", None, 403),
        ("/?token=\udcff", None, 403),
        (f"/?Token={TOKEN}", None, 403),
        (f"/?token={TOKEN}&websocket=wss://evil.example", None, 403),
        (f"/?token={TOKEN}", None, 303),
        ("/", "right", None),
        ("/assets/x.js", "right", None),
        ("/", f"yam_view={TOKEN}", 403),  # of a server with another token
        ("/", "right-wrong", 403),
    ],
)
def test_tokens_where_others_can_come(path, cookie, status):
    access = Access(ABROAD, TOKEN)
    right = cookie_of(access)
    given = {"right": f"other=1; {right}", "right-wrong": f"{right}x"}.get(cookie, cookie)
    headers = [("Host", "robot:8080"), *([("Cookie", given)] if given else [])]
    answer = access.answer(request(path, *headers))
    assert (answer and answer.status_code) == status


def test_the_token_leaves_the_address_and_stays_in_the_cookie():
    answer = Access(ABROAD, TOKEN).answer(request(f"/?token={TOKEN}", ("Host", "robot:8080")))
    assert answer.headers["Location"] == "/" and TOKEN not in answer.body.decode()
    assert {"HttpOnly", "SameSite=Lax"} <= set(answer.headers["Set-Cookie"].split("; "))


def test_servers_with_other_tokens_keep_their_own_cookies():
    names = {cookie.partition("=")[0] for cookie in (cookie_of(Access(ABROAD, TOKEN)), "yam_view_0=x")}
    other = Access(ABROAD, "another").answer(request("/?token=another", ("Host", "robot:8081")))
    assert len(names | {other.headers["Set-Cookie"].partition("=")[0]}) == 3


def test_a_page_of_elsewhere_is_refused_with_the_token_too():
    access = Access(ABROAD, TOKEN)
    headers = [("Host", "robot:8080"), ("Origin", "http://evil.example"), ("Cookie", cookie_of(access))]
    assert access.answer(request("/", *headers)).status_code == 403


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.168.1.7", "robot", "127.0.0.1.evil.example"])
def test_others_need_a_token(host):
    assert not is_loopback(host)
    with pytest.raises(ConfigError, match="token"):
        Access(host, None)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.5", "::1", "localhost"])
def test_addresses_of_this_computer_only(host):
    assert is_loopback(host)
