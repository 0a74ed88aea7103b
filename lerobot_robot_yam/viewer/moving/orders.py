"""What browsers have asked for, and waits to be done. Each browser has its share: none can make the others' wait."""

from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

_MOST_A_ROUND = 50  # a page that sends more has them grow old
_MOST_CONTROLLING = 200  # of a browser: a drag, in the time in which they grow old
_MOST_FREE = 4  # of a browser, of what needs no control


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
