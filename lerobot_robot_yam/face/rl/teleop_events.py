"""What a person at the leaders tells LeRobot's RL stack: who drives, and how an episode ends."""

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping

from lerobot.teleoperators.utils import TeleopEvents

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.operator_keys.auto_episodes import LIFTED
from lerobot_robot_yam.face.operator_keys.meanings import Meaning, RisingEdges, buttons_of
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import ArmState

logger = logging.getLogger(__name__)

_PERIOD_S = 0.005  # of the look at the handles; LeRobot looks ten times a second
_RESET_S = 0.5  # without a question: LeRobot has reset the arm meanwhile
_END_S = 1.0

_EVENTS = {
    Meaning.SUCCESS: (TeleopEvents.SUCCESS,),
    Meaning.FAILURE: (TeleopEvents.TERMINATE_EPISODE,),
    Meaning.NEXT: (TeleopEvents.TERMINATE_EPISODE,),
    Meaning.RERECORD: (TeleopEvents.TERMINATE_EPISODE, TeleopEvents.RERECORD_EPISODE),
    Meaning.DISCARD: (TeleopEvents.TERMINATE_EPISODE, TeleopEvents.RERECORD_EPISODE),
}
_ENDINGS = (TeleopEvents.TERMINATE_EPISODE, TeleopEvents.SUCCESS, TeleopEvents.RERECORD_EPISODE)


class TeleopEventWatch:
    """Watches the handles and gates of a leader device, from the first question on.

    A person intervenes from the button `correct` to the next press of it, or to `go_on`; and while all leaders with a
    gate are lifted.

    Args:
        meanings: of buttons, such as left_bottom.
        read: the newest state of each arm by its prefix.
    """

    def __init__(self, meanings: Mapping[str, Meaning], read: Callable[[], Mapping[str, ArmState]]):
        self._meanings, self._read = meanings, read
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._ends = threading.Event()
        self._corrects = False
        self._came: set[TeleopEvents] = set()
        self._asked_s = -math.inf

    def intervenes(self) -> bool:
        """Whether a person drives. Raises YamError: an arm is silent."""
        self._start()
        states = list(self._read().values())
        if any(state.mode is Mode.STOPPED for state in states):
            return False
        gates = [state.gate for state in states if state.gate]
        return self._corrects or bool(gates) and all(gate in LIFTED for gate in gates)

    def take(self) -> dict[TeleopEvents, bool]:
        """The events since the last call, each told once, and whether a person drives.

        What came while nobody asked for half a second was meant for an episode that has ended, and is dropped.

        Raises:
            YamError: see `intervenes`.
        """
        intervenes, now_s = self.intervenes(), time.monotonic()
        with self._lock:
            came, self._came = self._came, set()
        asked_s, self._asked_s = self._asked_s, now_s
        if came and now_s - asked_s > _RESET_S:
            logger.info("what was pressed while the arm was reset counts for nothing")
            came = set()
        return {TeleopEvents.IS_INTERVENTION: intervenes, **{event: event in came for event in _ENDINGS}}

    def stop(self) -> None:
        """Watch no more, and forget. Idempotent."""
        thread, self._thread = self._thread, None
        self._ends.set()
        if thread is not None:
            thread.join(_END_S)
        self._corrects, self._came = False, set()

    def _start(self) -> None:
        if self._thread is None and self._meanings:
            self._ends = threading.Event()
            self._thread = threading.Thread(target=self._run, args=(self._ends,), name="teleop events", daemon=True)
            self._thread.start()

    def _run(self, ends: threading.Event) -> None:
        edges = RisingEdges()
        while not ends.wait(_PERIOD_S):
            try:
                pressed = edges.pressed(buttons_of(self._read()))
            except YamError as error:  # the arms are off, or their loop is gone, which others say
                logger.debug("no buttons: %s", error)
                continue
            for button in pressed:
                if button in self._meanings:
                    self._answer(button, self._meanings[button])

    def _answer(self, button: str, meaning: Meaning) -> None:
        if meaning in (Meaning.CORRECT, Meaning.GO_ON):
            self._corrects = meaning is Meaning.CORRECT and not self._corrects
            logger.info("button %s: %s", button, "a person intervenes" if self._corrects else "the policy drives")
        elif meaning in _EVENTS:
            with self._lock:
                self._came |= set(_EVENTS[meaning])
            logger.info("button %s: %s", button, meaning)
        else:
            logger.warning("button %s (%s): means nothing to LeRobot's RL stack", button, meaning)
