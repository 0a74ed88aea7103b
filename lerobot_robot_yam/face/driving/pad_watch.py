"""Watch of one gamepad: buttons that act at once, deflections for the base, loss and return of the pad."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from lerobot_robot_yam.errors import LifeCycleError, YamError
from lerobot_robot_yam.face.driving.base_drive import STOPPED, VALID_S, Asked, shaped
from lerobot_robot_yam.face.driving.pad_map import CALIBRATE, DIRECTIONS, FRAME, OVERRIDE, RESET, SLOW, STOP, PadMap
from lerobot_robot_yam.face.driving.sdl_pads import Pad
from lerobot_robot_yam.face.lerobot_command.running_command import Meaning
from lerobot_robot_yam.face.operator_keys import requests
from lerobot_robot_yam.face.operator_keys.handle_buttons import RisingEdges
from lerobot_robot_yam.face.operator_keys.requests import Press
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)

_PERIOD_S = 0.01  # reading interval while LeRobot's loop does not ask, s: a short press of the stop button counts
_AGAIN_S = 1.0  # interval of looking for a lost pad, s
_END_S = 1.0  # timeout of joining the thread, s

Found = tuple[Pad, PadMap]


class PadWatch:
    """Watch of one gamepad, see `Driver`.

    The emergency stop and the override of a policy act in a thread, since LeRobot asks for no action while it saves an
    episode or while a policy drives. The thread also notes a stop that is released again meanwhile.

    Args:
        find: function that opens the pad and loads its map; it raises YamError without one.
        dead_zones: of x, y, theta, height.
        expo: see `shaped`.
        stop: the emergency stop.
    """

    def __init__(
        self, find: Callable[[], Found], dead_zones: tuple[float, float, float, float], expo: float, stop: EmergencyStop
    ):
        self._find, self._dead_zones, self._expo, self._stop = find, dead_zones, expo, stop
        self._pad, self._map = find()
        self._lock, self._ends = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None
        self._lost, self._sought_s = False, 0.0
        self._stopped = False  # whether the emergency stop was latched since `asked`
        self._edges, self._presses = RisingEdges(), deque[tuple[float, str]]()
        self._held: dict[str, bool] = {}
        self._deflection = (0.0, 0.0, 0.0, 0.0)

    def check_rest(self, device: str) -> None:
        """Raise LifeCycleError if an axis is off its rest; the message names it."""
        asked = self.asked()
        if asked.trouble:
            raise LifeCycleError(f"{device}: {asked.trouble}")
        for name, value in zip(DIRECTIONS, asked.deflection, strict=True):
            if value:
                use = self._map.axes[name]
                raise LifeCycleError(
                    f"{device}: the stick of {name} (axis {use.axis} of {self._pad.name}) is off its rest, at "
                    f"{value:+.2f}; let go of it. If nobody touches it, calibrate: {CALIBRATE}"
                )

    def start(self) -> None:
        """Start the thread."""
        self._thread = threading.Thread(target=self._run, name="gamepad", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, and release the pad. Idempotent."""
        self._ends.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(_END_S)
        with self._lock:
            self._pad.close()

    def asked(self) -> Asked:
        """Read the pad now, and return what the person asks."""
        with self._lock:
            now = time.monotonic()
            self._read(now)
            presses = [press for at_s, press in self._presses if now - at_s < VALID_S]
            self._presses.clear()
            stopped, self._stopped = self._stopped, False
            if self._lost:
                return Asked(trouble=f"the gamepad {self._pad.name} is unplugged, or out of reach")
            if stopped:
                return Asked(trouble=STOPPED)
            return Asked(self._deflection, self._held.get(SLOW, False), presses)

    def _run(self) -> None:
        while not self._ends.wait(_PERIOD_S):
            try:
                with self._lock:
                    self._stopped |= self._stop.latched
                    self._read(time.monotonic())
            except Exception:
                logger.exception("the buttons of the gamepad do nothing until the next action")

    def _read(self, now: float) -> None:
        reading = None if self._lost else self._pad.read()
        if reading is None:
            self._lose(now)
            return
        deflections = self._map.deflections(reading)
        rows = zip(DIRECTIONS, self._dead_zones, strict=True)
        x, y, theta, height = (shaped(deflections.get(name, 0.0), zone, self._expo) for name, zone in rows)
        self._deflection = x, y, theta, height
        before, self._held = self._held, self._map.pressed(reading)
        for use in self._edges.pressed(self._held):
            if use == STOP:
                self._stop_all()
            elif use in (FRAME, RESET):
                self._presses.append((now, use))
            elif use == OVERRIDE:
                self._override(Meaning.CORRECT)
        if before.get(OVERRIDE) and not self._held.get(OVERRIDE):
            self._override(Meaning.GO_ON)

    def _lose(self, now: float) -> None:
        """Forget what was held; look for the pad from time to time."""
        self._held, self._edges, self._deflection = {}, RisingEdges(), (0.0, 0.0, 0.0, 0.0)
        self._presses.clear()
        if not self._lost:
            self._lost, self._sought_s = True, now
            logger.warning("the gamepad %s is gone, and with it its emergency stop", self._pad.name)
        elif now - self._sought_s > _AGAIN_S:
            self._sought_s = now
            try:
                found = self._find()
            except YamError:  # not yet
                return
            self._pad.close()
            self._pad, self._map = found
            self._lost = False
            logger.info("the gamepad %s is back", self._pad.name)

    def _stop_all(self) -> None:
        try:
            self._stop.latch(f"button of the gamepad {self._pad.name}", "gamepad")
        except OSError as error:
            logger.critical("the emergency stop reaches only this program: %s", error)

    def _override(self, meaning: Meaning) -> None:
        if not requests.ask(Press(f"override of {self._pad.name}", meaning)):
            logger.warning("override: there is no policy to take over from")
