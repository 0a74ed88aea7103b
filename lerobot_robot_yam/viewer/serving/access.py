"""Who may reach the page: this computer's own browsers, and others that know the token. Never a page of elsewhere.

A browser sends any page's WebSocket to any address, and a name can be made to lead to 127.0.0.1. So the page that
opens one, its `Origin`, must be ours, and on a loopback address the `Host` must be a name of this computer.

viser (1.1) has no hook for this. While its server starts, `websockets.asyncio.server.serve` is ours, which adds the
check before viser's own answer. `guarded` fails if viser did not use it.
"""

import contextlib
import hmac
import ipaddress
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from lerobot_robot_yam.errors import ConfigError

_COOKIE = "yam_view"
_LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
_starting = threading.Lock()


class Access:
    """Judges each request by its headers.

    Args:
        host: the address that the server binds to.
        token: that others must bring: in the URL first (`?token=`), then in the cookie that they get for it. None: none
            is asked for.

    Raises:
        ConfigError: an address that others can reach, without a token.
    """

    def __init__(self, host: str, token: str | None):
        self._local = is_loopback(host)
        if not self._local and not token:
            raise ConfigError(f"{host} can be reached by others: it needs a token")
        self._token = token

    def refusal(self, request: Request) -> str:
        """Why a request is refused; empty: it is not."""
        host = request.headers.get("Host", "")
        if self._local and urlsplit(f"//{host}").hostname not in _LOCAL_NAMES:
            return "this page is served under the names of this computer only"
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return "a page of another origin may not use this one"
        if self._token is not None and not (self._in_url(request) or self._in_cookie(request)):
            return "the token is missing or wrong: open the address that yam-view has printed"
        return ""

    def _in_url(self, request: Request) -> bool:
        return any(self._same(given) for given in parse_qs(urlsplit(request.path).query).get("token", ()))

    def _in_cookie(self, request: Request) -> bool:
        pairs = (pair.strip().partition("=") for line in request.headers.get_all("Cookie") for pair in line.split(";"))
        return any(name == _COOKIE and self._same(value) for name, _, value in pairs)

    def _same(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), (self._token or "").encode())

    def admit(self, request: Request, response: Response | None) -> Response | None:
        """The answer to a request that is not refused; with the cookie, if it brings the token in its URL."""
        if response is not None and self._token is not None and self._in_url(request):
            response.headers["Set-Cookie"] = f"{_COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
        return response


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this computer only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@contextlib.contextmanager
def guarded(access: Access) -> Iterator[None]:
    """Inside the block one viser server is started; its requests are judged first.

    Raises:
        ConfigError: viser has started without it: this version does not fit.
    """
    module = websockets.asyncio.server
    asked: list[bool] = []
    with _starting:
        plain = module.serve

        def serve(*arguments: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
            asked.append(True)

            def process(connection: Any, request: Request) -> Response | None:
                why = access.refusal(request)
                if why:
                    text = f"{why}\n".encode()
                    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(text))})
                    return Response(HTTPStatus.FORBIDDEN, "Forbidden", headers, text)
                return access.admit(request, process_request(connection, request) if process_request else None)

            return plain(*arguments, process_request=process, **options)

        module.serve = serve  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            module.serve = plain  # type: ignore[misc]
    if not asked:
        raise ConfigError("this version of viser cannot be guarded; install viser 1.1")
