"""Says what the LeRobot command in this process does, and takes requests, for a page beside it. Slows it in nothing.

All work is done by a thread of its own, a few times a second. So requests are taken while LeRobot saves, too, and are
not done later, in another phase.
"""

import contextlib
import logging
import threading
import time
from types import FrameType

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.lerobot_command.command_facts import CommandFacts, TickPace
from lerobot_robot_yam.face.lerobot_command.running_command import command_of
from lerobot_robot_yam.face.operator_keys import requests
from lerobot_robot_yam.face.operator_keys.meanings import Meaning
from lerobot_robot_yam.face.operator_keys.operator_keys import OperatorKeys
from lerobot_robot_yam.face.operator_keys.requests import Press
from lerobot_robot_yam.state.desk_post import Asked, DeskPost
from lerobot_robot_yam.system.runtime_files import runtime_dir

logger = logging.getLogger(__name__)

_TOLD_S = 0.5
_WAIT_S = 0.25
_PAUSE_S = 0.05  # between two handfuls of requests
_COMPLAIN_S = 10.0
_END_S = 2.0
_one = threading.Lock()  # of a process: environments of lerobot-eval may have several robots


class SessionDesk:
    """Desk of one robot, from its connect to its disconnect. Does nothing under other programs, and never raises."""

    def __init__(self) -> None:
        self._pace = TickPace()
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None
        self._post: DeskPost
        self._complained_s = -_COMPLAIN_S
        self._keys = OperatorKeys({}, auto=False, by_request=True)

    def begin(self, frame: FrameType | None) -> None:
        """Before the arms are energised. `frame`: the robot's."""
        try:
            found = command_of(frame)
            if found is None or not _one.acquire(blocking=False):
                return
            try:
                self._post = post = DeskPost(runtime_dir())
            except BaseException:
                _one.release()
                raise
        except (OSError, YamError) as error:
            logger.warning("no page can show this command: %s", error)
            return
        self._keys.start(frame, dict)
        self._ends.clear()
        arguments = post, CommandFacts(*found, self._pace)
        self._thread = threading.Thread(target=self._run, args=arguments, name="session desk", daemon=True)
        self._thread.start()

    def observed(self) -> None:
        """The command's loop has observed."""
        self._pace.tick()

    def end(self) -> None:
        """Idempotent."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._ends.set()
        self._post.wake()
        thread.join(_END_S)
        try:
            self._keys.stop()
        except Exception as error:
            logger.warning("labels that a page has asked for may be lost: %r", error)
        _one.release()

    def _run(self, post: DeskPost, facts: CommandFacts) -> None:
        told_s = 0.0
        try:
            while not self._ends.is_set():
                asked, malformed = post.asked(_WAIT_S)
                unknown = [one for one in dict.fromkeys(asked) if not self._pass_on(one)]
                if malformed or unknown:
                    self._complain(malformed + len(unknown))
                if asked or malformed:
                    self._ends.wait(_PAUSE_S)
                if time.monotonic() - told_s >= _TOLD_S:
                    told_s = time.monotonic()
                    with contextlib.suppress(OSError):  # a full disk; the page says how old the status is
                        post.tell(facts.look())
        except Exception as error:
            logger.warning("no page shows this command from now on: %r", error)
        finally:
            post.close()

    def _pass_on(self, asked: Asked) -> bool:
        try:
            press = Press(asked.by, Meaning(asked.meaning), asked.turn)
        except ValueError:
            return False
        if not requests.ask(press):
            logger.warning("%s (%s): this command can be asked for nothing", press.by, press.meaning)
        return True

    def _complain(self, count: int) -> None:
        now_s = time.monotonic()
        if now_s - self._complained_s > _COMPLAIN_S:
            self._complained_s = now_s
            logger.warning("ignored %d request%s that nobody understands", count, "s" * (count > 1))
