"""When a button is pressed: it was up, and is down. The control loop has taken bounces out before."""

from collections.abc import Mapping

from lerobot_robot_yam.face.operator_keys.meanings import BUTTONS
from lerobot_robot_yam.state.records import ArmState


class RisingEdges:
    """Of a set of buttons. One that is down at first, or when its handle is heard again, has to be up before."""

    def __init__(self) -> None:
        self._up: set[str] = set()  # at the last look

    def pressed(self, buttons: Mapping[str, bool | None]) -> list[str]:
        """The buttons that were pressed since the last look. None: its handle is silent, nobody knows."""
        edges = [name for name, down in buttons.items() if down and name in self._up]
        self._up = {name for name, down in buttons.items() if down is False}
        return edges


def buttons_of(states: Mapping[str, ArmState]) -> dict[str, bool | None]:
    """Whether each button, such as left_bottom, is down, of arms by prefix; None: its handle is silent."""
    return {
        f"{prefix}{name}": None if state.trigger is None else down
        for prefix, state in states.items()
        for name, down in zip(BUTTONS, state.buttons, strict=True)
    }
