"""Web server of the page: viser behind the access gate, and the loop that updates each part of the page."""

import contextlib
import errno
import io
import logging
import math
import secrets
import socket
import time
from collections.abc import Iterator, Sequence
from typing import Protocol

import viser

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.viewer.serving.access import Access, is_loopback
from lerobot_robot_yam.viewer.serving.guarded_server import Gate, guarded

logger = logging.getLogger(__name__)

_PERIOD_S = 0.05
_PORTS_TRIED = 100
_SAID_EVERY_S = 60.0
_EVERYWHERE = ("", "0.0.0.0", "::")
_FAILED = "A PART OF THIS PAGE HAS FAILED, {name}: what it shows is old. See the terminal of yam-view."


class Part(Protocol):
    """Part of the page, updated by `Page.run`."""

    def update(self, now_s: float) -> None:
        """Show the state at `now_s`, a time of the monotonic clock."""

    def close(self) -> None:
        """Release all resources of this part. Idempotent."""


class Page:
    """Web server of the page.

    Args:
        host, port: address to listen on; if the port is taken, the next free port is used.
        with_token: whether to require a token on loopback addresses, too. Other addresses always require one.

    Attributes:
        server: viser's server.
        url: address to open in a browser, including the token if one is required.
        troubles: messages about failed parts, for the banner.

    Raises:
        ConfigError: viser's version is incompatible, or the address cannot be used.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080, with_token: bool = False):
        self.troubles: list[str] = []
        self._said_s: dict[str, float] = {}
        token = secrets.token_urlsafe(24) if with_token or not is_loopback(host) else None
        gate = Gate(Access(host, token))
        port = _free_port(host, port)
        with guarded(gate), contextlib.redirect_stdout(io.StringIO()):  # hides the text that viser prints
            self.server = viser.ViserServer(host=host, port=port, label="yam-view", verbose=False)
        gate.server = self.server
        self.server.gui.configure_theme(control_width="large", show_share_button=False, brand_color=(240, 120, 20))
        name = socket.gethostname() if host in _EVERYWHERE else host
        query = "" if token is None else f"/?token={token}"
        self.url = f"http://{f'[{name}]' if ':' in name else name}:{self.server.get_port()}{query}"

    def run(self, parts: Sequence[Part]) -> None:
        """Update the parts until interrupted. An error in one part does not affect the others."""
        due_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            with self.server.atomic():
                failed = [type(part).__name__ for part in parts if not self._updated(part, now_s)]
            self.troubles[:] = [_FAILED.format(name=name) for name in failed]
            due_s = max(due_s + _PERIOD_S, now_s)
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _updated(self, part: Part, now_s: float) -> bool:
        try:
            part.update(now_s)
        except Exception:  # a defect in our code: the page with its emergency stop keeps running, as do the arms
            name = type(part).__name__
            if now_s - self._said_s.get(name, -math.inf) >= _SAID_EVERY_S:
                self._said_s[name] = now_s
                logger.exception("a part of the page has failed: %s", name)
            return False
        return True

    def close(self) -> None:
        """Stop the server. Idempotent."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


@contextlib.contextmanager
def served(page: Page, parts: Sequence[Part]) -> Iterator[None]:
    """Close the parts and then the page on leaving the `with` block, even after an error."""
    try:
        yield
    finally:
        for part in reversed(parts):
            try:
                part.close()
            except Exception:
                logger.exception("a part of the page did not close")
        page.close()


def _free_port(host: str, port: int) -> int:
    """Return the first free port, starting at `port`. On a port in use, viser would wait forever.

    Raises:
        ConfigError: no port is free, or the address does not belong to this computer.
    """
    why = "there is no such port"
    for candidate in range(max(port, 0), min(port + _PORTS_TRIED, 1 << 16)):
        try:
            socket.create_server((host, candidate), family=_family(host)).close()
            return candidate
        except OSError as error:
            why = str(error)
            if error.errno != errno.EADDRINUSE:
                break
    raise ConfigError(f"yam-view cannot listen on {host} port {port}: {why}")


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET
