"""The rig's event log: in order, with simulated times and those of its clock."""

import contextlib
import itertools
import logging
import time
from collections import deque
from pathlib import Path
from typing import Any, TextIO

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.client.launch import to_json
from lerobot_robot_yam.system.clock import Clock

logger = logging.getLogger(__name__)

_KEPT = 20_000


class EventLog:
    """Numbered events; the oldest are forgotten."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._events: deque[dict[str, Any]] = deque(maxlen=_KEPT)
        self._next = 0
        self.sim_s = 0.0
        self._file: TextIO | None = None

    def keep(self, path: Path) -> None:
        """From now on also append every event to a file, one JSON object a line; the first relates the clocks.

        Raises:
            ConfigError: it cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(path, "a", buffering=1, encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"option event_dir: {error}; choose a folder that can be written") from error
        self.add("rig_started", unix_s=time.time())

    def close(self) -> None:
        """Close the file. Idempotent."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def add(self, kind: str, **details: Any) -> None:
        """Log an event of `kind`; `details` must be representable in JSON."""
        ours = {"number": self._next, "sim_s": round(self.sim_s, 4), "monotonic_s": self._clock.now(), "kind": kind}
        event = details | ours
        self._events.append(event)
        self._next += 1
        if self._file is not None:
            try:
                self._file.write(to_json(event).decode() + "\n")
            except OSError as error:  # recordings fill disks; the arms go on
                logger.error("the event log is no longer written: %s", error)
                with contextlib.suppress(OSError):
                    self.close()

    def since(self, number: int, limit: int) -> list[dict[str, Any]]:
        """At most `limit` events from `number` on."""
        return list(itertools.islice((event for event in self._events if event["number"] >= number), limit))
