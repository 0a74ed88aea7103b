"""Finding an adapter by plugging it in: the person plugs, sysfs tells."""

import time
from collections.abc import Callable
from pathlib import Path

from lerobot_robot_yam.doctor.kit.can_adapters import Adapter, read_adapters

_POLL_S = 0.2
_SETTLE_S = 0.8  # an adapter's channels come one after another, and udev renames them


class PlugWatch:
    """What is plugged in after this was made. Make it before the person is asked to plug.

    Args:
        sysfs: of the computer.
    """

    def __init__(self, sysfs: Path):
        self._sysfs = sysfs
        self._before = set(_places(sysfs))

    def wait(self, answer: Callable[[float], str | None], tell: Callable[[str], None]) -> list[Adapter] | str:
        """Wait until one adapter is plugged in, or plugged in again, or the person types a line.

        Args:
            answer: waits at most so many seconds for a typed line; None when there is none.
            tell: takes a line of text.

        Returns:
            The channels of the adapter, or the line.
        """
        while (line := answer(_POLL_S)) is None:
            now = _places(self._sysfs)
            if set(now) - self._before:
                time.sleep(_SETTLE_S)
                now = _places(self._sysfs)
                new = [adapter for key, adapter in now.items() if key not in self._before]
                if len({a.usb.port if a.usb else a.place for a in new}) == 1:
                    return new
                if new:
                    self._before = set(now)
                    tell(f"several came at once: {', '.join(a.name for a in new)}; unplug them, and plug in one")
            self._before &= set(now)
        return line


def _places(sysfs: Path) -> dict[tuple[str | None, ...], Adapter]:
    """What is plugged in, by place and channel: names change."""
    return {(a.place, *a.number, None if a.place else a.name): a for a in read_adapters(sysfs)}
