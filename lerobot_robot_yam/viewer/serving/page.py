"""The server of the page: viser behind its access check, and the loop that brings every part of the page up to date."""

import contextlib
import io
import logging
import secrets
import time
from collections.abc import Iterator, Sequence
from typing import Protocol

from lerobot_robot_yam.errors import ConfigError

try:
    import viser
    import viser._messages

    from lerobot_robot_yam.viewer.serving.access import Access, guarded, is_loopback
except ImportError as error:
    raise ConfigError('yam-view needs viser: pip install "lerobot_robot_yam[view]"') from error

logger = logging.getLogger(__name__)

_PERIOD_S = 0.05
_NEVER = (viser._messages.ShareUrlRequest, viser._messages.ShareUrlDisconnect)  # would show the arms to the world


class Part(Protocol):
    """A part of the page."""

    def update(self, now_s: float) -> None:
        """Show what is so at this time of the monotonic clock."""

    def close(self) -> None:
        """Let go of everything. Idempotent."""


class Page:
    """One server.

    Args:
        host, port: where it listens; a port that is taken is followed by the next free one.

    Attributes:
        server: viser's.
        url: for a browser; with the token, if one is needed.

    Raises:
        ConfigError: viser is missing or does not fit.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080):
        token = None if is_loopback(host) else secrets.token_urlsafe(24)
        with guarded(Access(host, token)), contextlib.redirect_stdout(io.StringIO()):  # viser prints a box of its own
            self.server = viser.ViserServer(host=host, port=port, label="yam-view", verbose=False)
        for message in _NEVER:
            self.server._websock_server.unregister_handler(message)
        self.server.gui.configure_theme(control_width="large", show_share_button=False, brand_color=(240, 120, 20))
        name = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        query = "" if token is None else f"/?token={token}"
        self.url = f"http://{name}:{self.server.get_port()}{query}"

    def run(self, parts: Sequence[Part]) -> None:
        """Update the parts, until this is interrupted."""
        due_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            with self.server.atomic():
                for part in parts:
                    part.update(now_s)
            due_s = max(due_s + _PERIOD_S, now_s)
            time.sleep(max(0.0, due_s - time.monotonic()))

    def close(self) -> None:
        """End the server. Idempotent."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


@contextlib.contextmanager
def served(page: Page, parts: Sequence[Part]) -> Iterator[None]:
    """Whatever ends the block, the parts are closed, then the page."""
    try:
        yield
    finally:
        for part in reversed(parts):
            try:
                part.close()
            except Exception:
                logger.exception("a part of the page did not close")
        page.close()
