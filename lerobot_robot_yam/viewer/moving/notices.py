"""Notices to browsers: answers to commands, and what happens to the arms."""

import math
import time
from collections import deque
from typing import NamedTuple

_MOST_NOTICES = 50
_REPEATED_S = 2.0  # minimum time between two identical notices, s


class Notice(NamedTuple):
    """Text for one browser, or for all browsers if `browser` is None."""

    browser: int | None
    text: str


class Notices(deque[Notice]):
    """Notices to show. The reader removes them."""

    def __init__(self) -> None:
        super().__init__(maxlen=_MOST_NOTICES)
        self._said: dict[Notice, float] = {}

    def say(self, browser: int | None, text: str) -> None:
        """Add a notice, unless an identical notice was added within the last `_REPEATED_S`."""
        notice, now = Notice(browser, text), time.monotonic()
        if now - self._said.get(notice, -math.inf) < _REPEATED_S:
            return
        self._said = {told: when for told, when in self._said.items() if now - when < _REPEATED_S} | {notice: now}
        self.append(notice)

    def forget(self) -> None:
        """Let all notices be shown again, at the begin of a new session."""
        self._said = {}
