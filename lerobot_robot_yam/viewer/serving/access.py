"""Access to the page: for this computer's own browsers, and for others with the token. Never for a page of elsewhere.

A browser sends any page's WebSocket to any address, and a name can be made to point to 127.0.0.1. So the page that
opens one, its `Origin`, must be ours, and on a loopback address the `Host` must be a name of this computer.

A page of elsewhere could also show ours in a frame and lead a person's clicks onto it, or open it with viser's own
`?websocket=` and `?playbackPath=`, which make our page obey another server. So no frame may hold it, it may connect to
its own origin only, and no query but the token's is served.
"""

import hashlib
import hmac
import ipaddress
import re
from http import HTTPStatus
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

from lerobot_robot_yam.errors import ConfigError

_HOST = re.compile(r"[\w.:\[\]-]+", re.ASCII)
# viser's page is one file with its scripts and workers inside
_POLICY = (
    "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; connect-src 'self' data: blob: {lines}; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Access:
    """Judge of requests, by their headers.

    Args:
        host: the address that the server binds to.
        token: required of clients: in the URL first (`?token=`), then in the cookie that they get for it. None for
            none.

    Raises:
        ConfigError: an address that others can reach, without a token.
    """

    def __init__(self, host: str, token: str | None):
        self._local = is_loopback(host)
        if not self._local and not token:
            raise ConfigError(f"{host} can be reached by others: it needs a token")
        self._token = token or ""
        # cookies ignore ports, so each server has a name of its own
        self._cookie = f"yam_view_{hashlib.sha256(self._token.encode()).hexdigest()[:8]}"

    def answer(self, request: Request) -> Response | None:
        """Return a refusal, or a redirection for a URL with the token; None if the request is served."""
        try:
            why = self._refusal(request)
        except (ValueError, MultipleValuesError):  # malformed host or origin, or two of them
            why = "this request cannot be understood"
        if why:
            return plain_response(HTTPStatus.FORBIDDEN, why)
        if self._token and "?" in request.path and not _upgrades(request):
            way_on = plain_response(HTTPStatus.SEE_OTHER, "welcome")  # keeps the token out of the address bar
            way_on.headers["Location"] = "/"
            way_on.headers["Set-Cookie"] = f"{self._cookie}={self._token}; HttpOnly; SameSite=Lax; Path=/"
            return way_on
        return None

    def _refusal(self, request: Request) -> str:
        host = request.headers.get("Host", "").lower()
        name = urlsplit(f"//{host}").hostname
        if not _HOST.fullmatch(host) or (self._local and not is_loopback(name or "")):
            return "this page is served under the names of this computer only"
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin.lower()).netloc != host:
            return "a page of another origin may not use this one"
        query = parse_qs(urlsplit(request.path).query, keep_blank_values=True)
        if set(query) - {"token"}:
            return "this page takes no options in its address"
        if self._token and not any(self._is_token(given) for given in (*query.get("token", ()), *self._kept(request))):
            return "the token is missing or wrong: open the address that yam-view has printed"
        return ""

    def _kept(self, request: Request) -> list[str]:
        """Return the values of our cookies."""
        pairs = [pair.strip().partition("=") for line in request.headers.get_all("Cookie") for pair in line.split(";")]
        return [value for name, _, value in pairs if name == self._cookie]

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="replace"), self._token.encode())


def plain_response(status: HTTPStatus, text: str) -> Response:
    """Return a line of text for a browser."""
    body = f"{text}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)


def shield(request: Request, response: Response) -> Response:
    """Add headers to the response that keep a browser from lending the page to others."""
    hosts = [host for host in request.headers.get_all("Host") if _HOST.fullmatch(host)]
    lines = " ".join(f"ws://{host} wss://{host}" for host in hosts)  # not every browser takes 'self' for WebSockets
    response.headers["Content-Security-Policy"] = _POLICY.format(lines=lines)
    for name, value in _HEADERS.items():
        response.headers[name] = value
    return response


def is_loopback(host: str) -> bool:
    """Return whether an address can be reached from this computer only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _upgrades(request: Request) -> bool:
    return "Upgrade" in request.headers
