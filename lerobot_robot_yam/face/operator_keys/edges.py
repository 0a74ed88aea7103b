"""When a button is pressed: it was up, and is down. The control loop has taken bounces out before."""

from collections.abc import Mapping


class RisingEdges:
    """Of a set of buttons. One that is down at first, or when its handle is heard again, has to be up before."""

    def __init__(self) -> None:
        self._up: set[str] = set()  # at the last look

    def pressed(self, buttons: Mapping[str, bool | None]) -> list[str]:
        """The buttons that were pressed since the last look. None: its handle is silent, nobody knows."""
        edges = [name for name, down in buttons.items() if down and name in self._up]
        self._up = {name for name, down in buttons.items() if down is False}
        return edges
