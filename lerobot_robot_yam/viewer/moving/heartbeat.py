"""Heartbeats of browsers, the age of browsers' commands, and the queue of commands.

viser has no heartbeat. A WebSocket's own ping is answered by the browser's network code, even while the page itself
hangs. So the page is asked repeatedly to look up an item of its local storage, which only the page's script can do;
the item does not matter.

A page's messages arrive in order, however late. So a command that arrives after the answer to a question was given
after that question: the question's time is the earliest at which a person can have given the command.
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

# Age of the newest answered question at which a page counts as lost, s; a driver's round later, in 0.5 s, arms hold.
SILENT_S = 0.4
OLD_S = 0.5  # age at which a command is dropped, s: the person has seen no effect and may have changed plans
_ASKED_S = 0.05  # period of the questions, s; each question makes the page draw its scene
_HELD_UP_S = 0.1  # gap between two rounds of the driver from which on this process counts as blocked, s
_MOST_OPEN = 16  # largest number of open questions to a page that hangs
_ITEM = "yam-view"
_MOST_A_ROUND = 50  # largest number of commands in a round; other commands wait
_MOST_CONTROLLING = 200  # largest number of waiting commands of a browser with control: a drag, until it is too old
_MOST_FREE = 4  # largest number of waiting requests of one browser that need no control


class _Pulse:
    """Questions to one browser (`open`: name of an open question → its time, s)."""

    def __init__(self) -> None:
        self.begun_s = time.monotonic()
        self.answered_s = -math.inf  # time of the newest answered question
        self.open: dict[str, float] = {}


class Heartbeat:
    """Questions to the browser that controls the arms, and to browsers where a person has to confirm something.

    `server`: viser's server; `holder`: function that returns the browser that controls the arms, or None.
    """

    def __init__(self, server: viser.ViserServer, holder: Callable[[], int | None]):
        self._server, self._holder = server, holder
        self._confirming: set[int] = set()
        self._pulses: dict[int, _Pulse] = {}
        self._names = itertools.count()
        self._looked_s = self._excused_s = -math.inf
        self._ended = threading.Event()
        # viser calls this handler in the order of arrival, like asynchronous callbacks of controls
        server._websock_server.register_handler(LocalStorageGetItemResponseMessage, self._take_answer)
        self._thread = threading.Thread(target=self._run, name="yam-view-heartbeat", daemon=True)
        self._thread.start()

    def begin(self, browser: int) -> None:
        """Start to watch this browser, which has just gained control. The browser's earlier answers do not count."""
        self._pulses[browser] = pulse = _Pulse()
        client = self._server.get_clients().get(browser)
        if client is not None:
            self._ask(client, pulse)

    def begin_question(self, browser: int) -> None:
        """Start to watch a browser where a person has to confirm something; call this before the person can confirm."""
        self._confirming.add(browser)
        self.begin(browser)

    def end_question(self, browser: int) -> None:
        """End `begin_question`. Idempotent."""
        self._confirming.discard(browser)

    def given_s(self, browser: int) -> float:
        """Return the earliest time (monotonic, s) of a command that arrives now; -inf if unknown."""
        pulse = self._pulses.get(browser)
        return -math.inf if pulse is None else pulse.answered_s

    def lost(self) -> bool:
        """Return whether the browser that controls the arms has been silent for too long; call this in each round.

        If this process itself was blocked, the page could not answer, and gets the full time again, but not repeatedly.
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
        """Record an answer; an answer that the browser refuses local storage counts, too."""
        pulse = self._pulses.get(browser)
        asked_s = None if pulse is None else pulse.open.pop(answer.request_uuid, None)
        if pulse is not None and asked_s is not None:
            pulse.answered_s = max(pulse.answered_s, asked_s)

    def close(self) -> None:
        """End the thread that sends the questions. Idempotent."""
        self._ended.set()
        self._thread.join()


def too_old(given_s: float) -> bool:
    """Return whether a command that was given at this time (monotonic, s) has to be dropped."""
    return time.monotonic() - given_s > OLD_S


class Order(NamedTuple):
    """Command in the queue.

    Attributes:
        browser: sender of the command.
        work: function that carries out the command.
        controls: whether the browser needs control.
        given_s: earliest time at which a person can have given the command (monotonic, s).
    """

    browser: int
    work: Callable[[], object]
    controls: bool
    given_s: float


class Orders:
    """Queue of commands. Any thread may add, one thread takes out."""

    def __init__(self) -> None:
        self._waiting: deque[Order] = deque()

    def add(self, order: Order, always: bool = False) -> bool:
        """Add an order and return True; return False if too many orders of this browser wait, unless `always`."""
        kinds = [(other.browser, other.controls) for other in self._waiting.copy()]
        most = _MOST_CONTROLLING if order.controls else _MOST_FREE
        if not always and kinds.count((order.browser, order.controls)) >= most:
            return False
        self._waiting.append(order)
        return True

    def of_a_round(self) -> Iterator[Order]:
        """Take out the orders for one round of the driver, oldest first."""
        for _ in range(min(len(self._waiting), _MOST_A_ROUND)):
            yield self._waiting.popleft()
