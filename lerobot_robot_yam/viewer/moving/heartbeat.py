"""Whether the browser that controls the arms is alive: its page is asked again and again, and has to answer.

viser has no heartbeat. A WebSocket's own ping is answered by the browser's network code, also while the page itself
hangs. So the page is asked for an item of its local storage, which its script has to look up. Nobody cares which.
"""

import math
import threading
import time
from collections.abc import Callable

import viser

SILENT_S = 0.4  # a page that has not answered for so long is lost: with a round of the driver, the arms hold in 0.5 s
_ASKED_S = 0.05
_ITEM = "yam-view"


class Heartbeat:
    """Asks one browser at a time.

    Args:
        server: viser's.
        holder: says which browser to ask; None: none.
    """

    def __init__(self, server: viser.ViserServer, holder: Callable[[], int | None]):
        self._server, self._holder = server, holder
        self._heard_s: dict[int, float] = {}
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="yam-view-heartbeat", daemon=True)
        self._thread.start()

    def begin(self, browser: int) -> None:
        """This browser has just been heard: it has taken control."""
        self._heard_s[browser] = time.monotonic()

    def lost(self) -> bool:
        """Whether the browser that controls the arms has been silent for too long."""
        holder = self._holder()
        return holder is not None and time.monotonic() - self._heard_s.get(holder, -math.inf) > SILENT_S

    def _run(self) -> None:
        while not self._ended.wait(_ASKED_S):
            holder = self._holder()
            client = None if holder is None else self._server.get_clients().get(holder)
            if client is not None and self._answers(client):
                self.begin(client.client_id)

    def _answers(self, client: viser.ClientHandle) -> bool:
        try:
            client.local_storage.get_item(_ITEM, timeout=SILENT_S)
        except TimeoutError:
            return False
        except RuntimeError:  # it has gone; or its browser refuses to look, which is an answer
            return client.client_id in self._server.get_clients()
        return True

    def close(self) -> None:
        """Ask no more. Idempotent."""
        self._ended.set()
        self._thread.join()
