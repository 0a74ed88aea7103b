"""Sends the newest states of all arms to whoever watches, right after each tick of their control loop."""

import logging
import secrets
import threading
from collections.abc import Callable, Sequence

from lerobot_robot_yam.remote.host.hosted_group import HostedGroup
from lerobot_robot_yam.remote.wire.link_messages import States, pack_states
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.realtime import request_scheduling

logger = logging.getLogger(__name__)

_RT_PRIORITY = 15  # below that of control loops
_AFTER_S = 0.0003  # a tick is due: nearly all have been published by then, and need not be looked for
_GLANCE_S = 0.00015
_LATE_S = 0.004  # a tick that is later is not waited for
_LEAST_S = 0.002  # between two messages: a loop may tick as fast as its wire allows, or no more
_QUIET_S = 0.1  # between two messages while no arm runs


class StateStream:
    """A thread that sends.

    Args:
        groups: of the host; the first that runs says when.
        publish: sends a message to all.
        stopped: whether the emergency stop is latched, and by which machine.
    """

    def __init__(
        self,
        groups: Sequence[HostedGroup],
        publish: Callable[[bytes], None],
        stopped: Callable[[], tuple[bool, int]],
    ):
        self._groups, self._publish, self._stopped = groups, publish, stopped
        self._run = secrets.randbits(63) + 1
        self._sent = 0  # number of the state that was there when the last message was made
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._stream, name="yam-states", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End. Idempotent."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _stream(self) -> None:
        request_scheduling(_RT_PRIORITY)
        while not self._ended.is_set():
            try:
                self._await_tick()
                self._send()
            except Exception:
                logger.exception("states were not sent")
                self._ended.wait(_QUIET_S)

    def _await_tick(self) -> None:
        """Wait for the next tick of the first group that runs."""
        lead = next((arm for group in self._groups for arm in group.arms[-1:] if arm.running), None)
        if lead is None:
            self._ended.wait(_QUIET_S)
            return
        newest, due_s = lead.next_state()
        if newest == self._sent:
            SYSTEM.sleep(max(_LEAST_S, due_s + _AFTER_S - SYSTEM.now()))
            while (newest := lead.next_state()[0]) == self._sent and SYSTEM.now() < due_s + _LATE_S:
                SYSTEM.sleep(_GLANCE_S)
        self._sent = newest

    def _send(self) -> None:
        news = [found for group in self._groups for arm in group.arms if (found := arm.news()) is not None]
        stopped, by = self._stopped()
        self._publish(pack_states(States(self._run, int(stopped), by, news)))
