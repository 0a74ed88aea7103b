"""Access control of the page: this computer's own browsers, and others with the token. Never a foreign page.

A browser lets any page open a WebSocket to any address, and a host name can be made to resolve to 127.0.0.1. So the
`Origin` of a WebSocket must be our page, and on a loopback address the `Host` must be a name of this computer.

A foreign page could also embed our page in a frame and lure a person into clicking there. Or it could open our page
with viser's own `?websocket=` and `?playbackPath=`, which make our page obey another server. So our page refuses to be
framed, may connect only to its own origin, and accepts no query parameter except the token.
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
# viser's page is a single file that includes its scripts and workers
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
    """Access check for HTTP requests, based on address, headers and token.

    Args:
        host: address that the server binds to.
        token: token that clients need, or None. Clients first send it in the URL (`?token=`), later in the cookie that
            they get in response.

    Raises:
        ConfigError: other computers can reach `host`, but there is no token.
    """

    def __init__(self, host: str, token: str | None):
        self._local = is_loopback(host)
        if not self._local and not token:
            raise ConfigError(f"{host} can be reached by others: it needs a token")
        self._token = token or ""
        # browsers send a cookie to all ports of a host: each server needs its own cookie name
        self._cookie = f"yam_view_{hashlib.sha256(self._token.encode()).hexdigest()[:8]}"

    def answer(self, request: Request) -> Response | None:
        """Return a refusal, or a redirect that removes the token from the URL; None if the request may be served."""
        try:
            why = self._refusal(request)
        except (ValueError, MultipleValuesError):  # malformed or repeated Host or Origin
            why = "this request cannot be understood"
        if why:
            return plain_response(HTTPStatus.FORBIDDEN, why)
        if self._token and "?" in request.path and not _upgrades(request):
            way_on = plain_response(HTTPStatus.SEE_OTHER, "welcome")  # hides the token from the address bar
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
        """Return the values of this server's cookies in a request."""
        pairs = [pair.strip().partition("=") for line in request.headers.get_all("Cookie") for pair in line.split(";")]
        return [value for name, _, value in pairs if name == self._cookie]

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="replace"), self._token.encode())


def plain_response(status: HTTPStatus, text: str) -> Response:
    """Return a plain-text response with one line of text."""
    body = f"{text}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)


def shield(request: Request, response: Response) -> Response:
    """Add security headers that keep foreign pages from embedding or using our page."""
    hosts = [host for host in request.headers.get_all("Host") if _HOST.fullmatch(host)]
    lines = " ".join(f"ws://{host} wss://{host}" for host in hosts)  # not all browsers apply 'self' to WebSockets
    response.headers["Content-Security-Policy"] = _POLICY.format(lines=lines)
    for name, value in _HEADERS.items():
        response.headers[name] = value
    return response


def is_loopback(host: str) -> bool:
    """Return whether an address is reachable from this computer only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _upgrades(request: Request) -> bool:
    return "Upgrade" in request.headers
