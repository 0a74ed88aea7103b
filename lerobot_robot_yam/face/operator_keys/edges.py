"""When a button is pressed: the first moment that it is down, and none of its bounces."""

from collections.abc import Mapping

_SETTLE_S = 0.03  # a contact that opens for less has bounced


class RisingEdges:
    """Of a set of buttons. One that is down at the first look, or when its handle is heard again, has to be up first.

    The edge itself counts, without a delay: only another one so soon after the button was down does not.
    """

    def __init__(self) -> None:
        self._was_up: dict[str, bool] = {}  # at the last look
        self._down_s: dict[str, float] = {}  # when each was down last

    def pressed(self, now_s: float, buttons: Mapping[str, bool | None]) -> list[str]:
        """The buttons that were pressed since the last look.

        Args:
            now_s: monotonic.
            buttons: whether each is down; None: its handle is silent.
        """
        edges = []
        for name, down in buttons.items():
            if down and self._was_up.get(name) and now_s - self._down_s.get(name, -_SETTLE_S) >= _SETTLE_S:
                edges.append(name)
            self._was_up[name] = down is False
            if down is not False:
                self._down_s[name] = now_s
        return edges
