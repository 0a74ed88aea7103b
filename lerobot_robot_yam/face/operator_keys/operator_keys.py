"""Thread with the effect of LeRobot's keys when a handle's button is pressed or a page sends the same request."""

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Mapping
from queue import Empty, SimpleQueue

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.lerobot_command import running_command
from lerobot_robot_yam.face.lerobot_command.running_command import LABELS, Meaning, Phase, Situation
from lerobot_robot_yam.face.operator_keys import key_plan, requests
from lerobot_robot_yam.face.operator_keys.auto_episodes import AutoEpisodes, all_lifted, led_by_hand
from lerobot_robot_yam.face.operator_keys.handle_buttons import Presses
from lerobot_robot_yam.face.operator_keys.key_plan import StopRequest
from lerobot_robot_yam.face.operator_keys.requests import Press
from lerobot_robot_yam.face.recorder.outcomes import OutcomeBook
from lerobot_robot_yam.state.arm_state import ArmState

logger = logging.getLogger(__name__)

_PERIOD_S = 0.005  # polling interval of the handles, s
_ASKED_PERIOD_S = 0.05  # polling interval of requests, without handles, s
_LOOK_S = 0.02  # interval between checks of the command while a key may be due, s
_SELDOM_S = 0.5  # interval between checks of the command at other times, for a new data set, s
_AGAIN_S = 2.0  # wait for the effect of an automatic key before it is pressed again, s
_END_S = 1.0  # timeout of joining the thread, s
_GOAL_S = 60.0  # timeout of reaching a phase, s: LeRobot aligns leaders for 2 s, and saving may take long


class OperatorKeys:
    """Keys that a leader device presses, from connect to disconnect. For a follower, only requests press keys.

    Args:
        meanings: name of a button, such as left_bottom → its meaning.
        auto: whether episodes begin when all leaders are lifted, and end when all are home.
        by_request: whether there are only requests and no handles.
    """

    def __init__(self, meanings: Mapping[str, Meaning], auto: bool, by_request: bool = False):
        self._meanings, self._automatic, self._by_request = meanings, auto, by_request
        self._thread: threading.Thread | None = None
        self._ends = threading.Event()
        self._forget()

    def _forget(self) -> None:
        self._presses, self._book, self._asked = Presses(), OutcomeBook(), SimpleQueue[Press]()
        self._auto = AutoEpisodes() if self._automatic else None
        self._goal: Phase | None = None
        self._stop: StopRequest | None = None
        self._goal_until_s = self._looked_s = self._pressed_s = 0.0
        self._last: tuple[Meaning, Phase, float] | None = None

    def start(self, read: Callable[[], Mapping[str, ArmState]]) -> None:
        """Start the thread. Does nothing without buttons, or under a command that does not listen to keys.

        read: callback that returns prefix → newest state of the arm.
        """
        if not (self._meanings or self._automatic or self._by_request):
            return
        if not running_command.hears_keys():
            if not self._by_request:
                logger.info("buttons of handles press keys of lerobot-record and lerobot-rollout only")
            return
        self._forget()
        self._ends = threading.Event()  # a new event, in case an earlier thread hangs
        requests.join(self, first=not self._by_request)  # a leader knows whether episodes are automatic
        self._thread = threading.Thread(target=self._run, args=(read, self._ends), name="operator keys", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Press no more keys. Does not wait for the thread."""
        self._ends.set()
        requests.leave(self)

    def stop(self) -> None:
        """End the thread, and write the last labels. Idempotent."""
        self.end()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(_END_S)
            self._book.close()

    def _run(self, read: Callable[[], Mapping[str, ArmState]], ends: threading.Event) -> None:
        while not ends.wait(_ASKED_PERIOD_S if self._by_request else _PERIOD_S):
            try:
                self._tick(time.monotonic(), read())
            except YamError as error:  # arms off or loop ended, which is reported elsewhere
                logger.debug("no buttons: %s", error)
            except Exception:
                if ends.is_set():  # the arms were released in the meantime
                    return
                logger.exception("the buttons of the handles do nothing from now on")
                return

    def _tick(self, now_s: float, states: Mapping[str, ArmState]) -> None:
        pressed = [Press(name, self._meanings[name]) for name in self._presses.new(states) if name in self._meanings]
        with contextlib.suppress(Empty):
            while True:
                pressed.append(self._asked.get_nowait())
        awaits = any((self._auto, self._goal, self._stop, self._book.pending))
        busy = awaits or now_s - self._pressed_s < _AGAIN_S
        if not pressed and now_s - self._looked_s < (_LOOK_S if busy else _SELDOM_S):
            return
        self._looked_s, now = now_s, running_command.look()
        self._book.open(now.dataset)
        if self._stop is not None and self._stop.advance(now):
            self._stop = None
        for press in pressed:
            self._answer(press, now, now_s)
        if self._goal is not None:
            self._approach(self._goal, now, now_s)
        key = key_plan.rescue(now) if self._pressed_s or not self._by_request else None
        if self._auto is not None:
            lifted = all_lifted([state.gate for state in states.values()])
            key = self._auto.key(lifted, led_by_hand(list(states.values())), now) or key
        if key is not None:
            self._press(key, now, now_s, again=True)
        self._book.look()

    def ask(self, press: Press) -> None:
        self._asked.put(press)

    def offers(self, now: Situation, first: int) -> dict[str, str]:
        return key_plan.offers(now, first, self._automatic)

    def _answer(self, press: Press, now: Situation, now_s: float) -> None:
        button, meaning = press.by, press.meaning
        if press.turn is not None and press.turn != now.turn:
            logger.warning("button %s (%s): came too late, %s has gone on", button, meaning, now.command)
            return
        if meaning in LABELS:
            frames = key_plan.frames_to_label(now, self._automatic)
            if frames is None or not self._book.label(meaning, frames, button):
                why = (
                    "there is no episode yet"
                    if frames is not None
                    else "the episode is dropped, there is none to label"
                )
                logger.warning("button %s (%s): %s", button, meaning, why)
                return
        goal, key = key_plan.wanted(meaning, now), key_plan.single_key(meaning, now)
        if meaning is Meaning.STOP and now.flags:
            self._stop = StopRequest(now)
        elif goal is not None:
            self._goal, self._goal_until_s, self._last = goal, now_s + _GOAL_S, None
        elif key is not None:
            self._press(key, now, now_s)
        elif meaning not in LABELS:
            logger.warning("%s", key_plan.refusal(meaning, button, now))
            return
        logger.info("button %s: %s", button, meaning)

    def _approach(self, goal: Phase, now: Situation, now_s: float) -> None:
        """Press the next key towards the goal, once for each phase on the path."""
        key = key_plan.step(goal, now)
        if key is not None and now_s < self._goal_until_s:
            self._press(key, now, now_s, again=False)
            return
        if key is not None:
            logger.warning("%s has not become %s", now.command, goal.value)
        self._goal = None

    def _press(self, key: Meaning, now: Situation, now_s: float, again: bool | None = None) -> None:
        """Press a key. again: when to repeat the same key: None: at once; True: after `_AGAIN_S`; False: never."""
        this = key, now.phase, now.turn
        if again is not None and this == self._last and (not again or now_s - self._pressed_s < _AGAIN_S):
            return
        self._last, self._pressed_s = this, now_s
        now.keys[key]()
