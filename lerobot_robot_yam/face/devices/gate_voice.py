"""Says aloud what the gates of leaders do, with LeRobot's voice, where a command's option `play_sounds` has it on."""

from collections.abc import Callable, Mapping
from types import FrameType

from lerobot_robot_yam.face.recorder.record_command import plays_sounds
from lerobot_robot_yam.state.modes import Gate

_WORDS = {
    Gate.HOMING: "going home",
    Gate.IDLE: "ready",
    Gate.APPROACH: "approaching",
    Gate.ENGAGED: "engaged",
    Gate.FINE: "fine mode",
    Gate.RECENTRE: "recentring",
}


class GateVoice:
    """Of one leader device.

    Args:
        together: its leaders have one gate.
    """

    def __init__(self, together: bool):
        self._together = together
        self._say: Callable[[str], None] | None = None
        self._before: dict[str, Gate] = {}

    def begin(self, frame: FrameType | None) -> None:
        """A session begins, from `frame`: find out whether its command speaks."""
        self._say, self._before = None, {}
        if plays_sounds(frame):
            from lerobot.utils.utils import say  # the command has loaded it

            self._say = say

    def tell(self, gates: Mapping[str, Gate]) -> None:
        """Say what has changed since the last call. Waits for nothing.

        Args:
            gates: of each leader by its prefix, such as left_.
        """
        if self._say is None:
            return
        if self._together:
            if len(set(gates.values())) > 1:  # a transition comes to the second leader one tick later
                return
            gates = {"": next(iter(gates.values()))}
        for prefix, gate in gates.items():
            if self._before.get(prefix, gate) is not gate:
                self._say(f"{prefix.replace('_', ' ')}{_WORDS[gate]}")
        self._before = dict(gates)
