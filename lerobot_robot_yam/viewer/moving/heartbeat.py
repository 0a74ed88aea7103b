"""Whether a browser is alive, how old its commands are, and the commands that wait to be done.

viser has no heartbeat. A WebSocket's own ping is answered by the browser's network code, also while the page itself
hangs. So the page is asked again and again for an item of its local storage, which its script has to look up. Nobody
cares which.

What a page sends arrives in order, however long the network keeps it. So a command that arrives after an answer was
sent after that question was asked: the time of the question is the earliest at which a person can have given it.
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

# A page that has answered no question younger than this is lost: with a round of the driver, the arms hold in 0.5 s.
SILENT_S = 0.4
OLD_S = 0.5  # a command that was given before is not done any more: the person has seen nothing happen
_ASKED_S = 0.05  # each question makes the page draw its scene once
_HELD_UP_S = 0.1  # between two rounds of the driver
_MOST_OPEN = 16  # questions to a page that hangs
_ITEM = "yam-view"
_MOST_A_ROUND = 50  # a page that sends more has them grow old
_MOST_CONTROLLING = 200  # of a browser: a drag, in the time in which they grow old
_MOST_FREE = 4  # of a browser, of what needs no control


class _Pulse:
    """Of one browser: its open questions by their names, each with the time when it was asked."""

    def __init__(self) -> None:
        self.begun_s = time.monotonic()
        self.answered_s = -math.inf  # when the newest question that has an answer was asked
        self.open: dict[str, float] = {}


class Heartbeat:
    """Asks the browser that controls the arms, and those in which a person is asked to confirm something.

    Args:
        server: viser's.
        holder: says which browser controls the arms; None: none.
    """

    def __init__(self, server: viser.ViserServer, holder: Callable[[], int | None]):
        self._server, self._holder = server, holder
        self._confirming: set[int] = set()
        self._pulses: dict[int, _Pulse] = {}
        self._names = itertools.count()
        self._looked_s = self._excused_s = -math.inf
        self._ended = threading.Event()
        # viser calls it in the order of what arrives, as it calls asynchronous callbacks of controls
        server._websock_server.register_handler(LocalStorageGetItemResponseMessage, self._take_answer)
        self._thread = threading.Thread(target=self._run, name="yam-view-heartbeat", daemon=True)
        self._thread.start()

    def begin(self, browser: int) -> None:
        """Ask this browser, which has taken control. Nothing that it has answered before counts."""
        self._pulses[browser] = pulse = _Pulse()
        client = self._server.get_clients().get(browser)
        if client is not None:
            self._ask(client, pulse)

    def begin_question(self, browser: int) -> None:
        """Ask this browser, too: call it before a person there is asked to confirm something."""
        self._confirming.add(browser)
        self.begin(browser)

    def end_question(self, browser: int) -> None:
        """The person has confirmed, or not. Idempotent."""
        self._confirming.discard(browser)

    def given_s(self, browser: int) -> float:
        """The earliest time (monotonic, s) at which a command that arrives now was given; -inf: it is not known."""
        pulse = self._pulses.get(browser)
        return -math.inf if pulse is None else pulse.answered_s

    def lost(self) -> bool:
        """Whether the browser that controls the arms has been silent for too long. It is called in every round.

        A page cannot answer while this process is held up itself. It then has its time anew, but not again and again.
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
        """Also one that says that the browser refuses to look."""
        pulse = self._pulses.get(browser)
        asked_s = None if pulse is None else pulse.open.pop(answer.request_uuid, None)
        if pulse is not None and asked_s is not None:
            pulse.answered_s = max(pulse.answered_s, asked_s)

    def close(self) -> None:
        """Ask no more. Idempotent."""
        self._ended.set()
        self._thread.join()


def too_old(given_s: float) -> bool:
    """Whether a command of this time (monotonic, s) is not to be done any more."""
    return time.monotonic() - given_s > OLD_S


class Order(NamedTuple):
    """One command.

    Attributes:
        browser: that has asked.
        work: does it.
        controls: whether the browser has to have control.
        given_s: when a person gave it, at the earliest (monotonic, s).
    """

    browser: int
    work: Callable[[], object]
    controls: bool
    given_s: float


class Orders:
    """A queue. Any thread adds to it, one takes out."""

    def __init__(self) -> None:
        self._waiting: deque[Order] = deque()

    def add(self, order: Order, always: bool = False) -> bool:
        """False: as many of this browser's wait as may; it is not added, unless always."""
        kinds = [(other.browser, other.controls) for other in self._waiting.copy()]
        most = _MOST_CONTROLLING if order.controls else _MOST_FREE
        if not always and kinds.count((order.browser, order.controls)) >= most:
            return False
        self._waiting.append(order)
        return True

    def of_a_round(self) -> Iterator[Order]:
        """Take out what is done in one round of the driver, oldest first."""
        for _ in range(min(len(self._waiting), _MOST_A_ROUND)):
            yield self._waiting.popleft()
