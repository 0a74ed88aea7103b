"""Heartbeats of browsers, the age of browsers' commands, and the command queue.

viser has no heartbeat. The browser's network code replies to WebSocket pings even while the page itself hangs. So the
ping sent here asks for an item of the page's local storage, which only the page's own script can look up. The item's
value does not matter.

A page's messages arrive in order, however late. So a command that arrives after the reply to a ping was given after
that ping was sent. The time of the newest answered ping is thus the earliest time at which the command was given.
"""

import itertools
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

import viser
from viser._messages import LocalStorageGetItemRequestMessage, LocalStorageGetItemResponseMessage

# Age of the newest answered ping above which a page counts as lost, s. The driver then holds the arms within 0.5 s.
SILENT_S = 0.4
OLD_S = 0.5  # age at which a command is dropped, s: the person has seen no effect and may have changed plans
_ASKED_S = 0.05  # ping period, s; each ping makes the page draw its scene
_HELD_UP_S = 0.1  # gap between rounds of the driver above which this process counts as blocked, s
_MOST_OPEN = 16  # maximum number of unanswered pings to one page
_ITEM = "yam-view"
_MOST_A_ROUND = 50  # maximum number of commands per round of the driver; further commands wait
_MOST_CONTROLLING = 200  # maximum queue length of the browser in control: a drag until its oldest command expires
_MOST_FREE = 4  # maximum number of queued requests per browser that do not require control


class _Pulse:
    """Heartbeat state of one browser. `open`: name of each unanswered ping → time at which it was sent, s."""

    def __init__(self) -> None:
        self.begun_s = time.monotonic()
        self.answered_s = -math.inf  # time at which the newest answered ping was sent, s
        self.open: dict[str, float] = {}


class Heartbeat:
    """Sender of pings to the browser that controls the arms and to browsers with an open confirmation dialogue.

    `server`: viser's server; `holder`: function that returns the browser that controls the arms, or None.
    """

    def __init__(self, server: viser.ViserServer, holder: Callable[[], int | None]):
        self._server, self._holder = server, holder
        self._confirming: set[int] = set()
        self._pulses: dict[int, _Pulse] = {}
        self._names = itertools.count()
        self._looked_s = self._excused_s = -math.inf
        self._ended = threading.Event()
        # viser calls this handler in the messages' order of arrival, as it does asynchronous callbacks of controls
        server._websock_server.register_handler(LocalStorageGetItemResponseMessage, self._take_answer)
        self._thread = threading.Thread(target=self._run, name="yam-view-heartbeat", daemon=True)
        self._thread.start()

    def begin(self, browser: int) -> None:
        """Start to monitor a browser that has just gained control. Its earlier replies no longer count."""
        self._pulses[browser] = pulse = _Pulse()
        client = self._server.get_clients().get(browser)
        if client is not None:
            self._ask(client, pulse)

    def begin_question(self, browser: int) -> None:
        """Start to monitor a browser with a confirmation dialogue. Call this before the person can confirm."""
        self._confirming.add(browser)
        self.begin(browser)

    def end_question(self, browser: int) -> None:
        """Stop monitoring a browser's confirmation dialogue. Idempotent."""
        self._confirming.discard(browser)

    def given_s(self, browser: int) -> float:
        """Return the earliest time (monotonic, s) at which a command that arrives now was given; -inf if unknown."""
        pulse = self._pulses.get(browser)
        return -math.inf if pulse is None else pulse.answered_s

    def lost(self) -> bool:
        """Return whether the browser that controls the arms has been silent for too long. Call this in each round.

        If this process was blocked, the browser gets the full timeout again, since its replies could not be read. This
        happens at most once per `2 * SILENT_S`.
        """
        now_s, before_s = time.monotonic(), self._looked_s
        self._looked_s = now_s
        if now_s - before_s > _HELD_UP_S and now_s - self._excused_s > 2 * SILENT_S:
            self._excused_s = now_s
        holder = self._holder()
        if holder is None:
            return False
        pulse = self._pulses.get(holder)
        return pulse is None or now_s - max(pulse.begun_s, pulse.answered_s, self._excused_s) > SILENT_S

    def _run(self) -> None:
        while not self._ended.wait(_ASKED_S):
            known, clients = list(self._pulses), self._server.get_clients()
            for browser in known:
                if browser not in clients:
                    self._pulses.pop(browser)
                    self._confirming.discard(browser)
                elif browser == self._holder() or browser in self._confirming:
                    pulse = self._pulses[browser]
                    if len(pulse.open) < _MOST_OPEN:
                        self._ask(clients[browser], pulse)

    def _ask(self, client: viser.ClientHandle, pulse: _Pulse) -> None:
        name = str(next(self._names))
        pulse.open[name] = time.monotonic()
        client._websock_connection.queue_message(LocalStorageGetItemRequestMessage(_ITEM, name))
        client.flush()

    def _take_answer(self, browser: int, answer: LocalStorageGetItemResponseMessage) -> None:
        """Record a reply. A reply in which the browser denies access to local storage also counts."""
        pulse = self._pulses.get(browser)
        asked_s = None if pulse is None else pulse.open.pop(answer.request_uuid, None)
        if pulse is not None and asked_s is not None:
            pulse.answered_s = max(pulse.answered_s, asked_s)

    def close(self) -> None:
        """End the thread that sends the pings. Idempotent."""
        self._ended.set()
        self._thread.join()


def too_old(given_s: float) -> bool:
    """Return whether a command given at this time (monotonic, s) must be dropped."""
    return time.monotonic() - given_s > OLD_S


class Order(NamedTuple):
    """Command in the queue.

    Attributes:
        browser: browser that sent the command.
        work: function that executes the command.
        controls: whether the command requires that its browser controls the arms.
        given_s: earliest time at which a person can have given the command (monotonic, s).
    """

    browser: int
    work: Callable[[], object]
    controls: bool
    given_s: float


class Orders:
    """Command queue. Any thread may add commands; only one thread may remove them."""

    def __init__(self) -> None:
        self._waiting: deque[Order] = deque()

    def add(self, order: Order, always: bool = False) -> bool:
        """Add a command and return True. If the queue is full for this browser, return False unless `always`."""
        kinds = [(other.browser, other.controls) for other in self._waiting.copy()]
        most = _MOST_CONTROLLING if order.controls else _MOST_FREE
        if not always and kinds.count((order.browser, order.controls)) >= most:
            return False
        self._waiting.append(order)
        return True

    def of_a_round(self) -> Iterator[Order]:
        """Remove and yield the commands for one round of the driver, oldest first."""
        for _ in range(min(len(self._waiting), _MOST_A_ROUND)):
            yield self._waiting.popleft()
