"""Session of one LeRobot device: started and landed with the device, on signals, and when the interpreter ends."""

import atexit
import contextlib
from collections.abc import Callable, Sequence

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.face.lerobot_command.running_command import under_a_command
from lerobot_robot_yam.face.recorder.kept_episodes import stop_after_saving, tell_what_is_kept
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.base_client import BaseClient
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.system.realtime import spare_what_is_loaded
from lerobot_robot_yam.system.signals import end_session_on_signals, undisturbed

connected_sessions: "list[DeviceSession]" = []
"""Sessions of the connected devices of this process."""


class DeviceSession:
    """The parts of one LeRobot device, arms and a base, driven by one control loop.

    Args:
        device: LeRobot's type name, for messages.
        parts: configurations of the parts.
        isolation: where the control loop runs, see `ArmSession`.
    """

    def __init__(self, device: str, parts: Sequence[ArmConfig | BaseConfig], isolation: Isolation):
        self.device = device
        self._session = ArmSession(parts, isolation)
        self._undo_signals: Callable[[], None] = lambda: None

    def base(self, name: str) -> BaseClient:
        """Return the client of the base called `name`. Raises LifeCycleError: the device is not connected."""
        return self._session.base(name)

    @property
    def bases(self) -> list[BaseClient]:
        """Clients of all bases; empty while the device is not connected."""
        return self._session.bases

    @property
    def connected(self) -> bool:
        """Whether the device is connected, in whatever mode its parts are."""
        return self._session.running

    @property
    def clock(self) -> Clock:
        return self._session.clock

    def energise(self, search_grippers: bool = True) -> None:
        """Energise all parts or none. Raises YamError: a part cannot be driven."""
        tell_what_is_kept()
        commanded = under_a_command()
        self._undo_signals = end_session_on_signals(stop_after_saving, commanded)
        if commanded:
            spare_what_is_loaded()
        try:
            self._session.start(search_grippers=search_grippers)
        except BaseException:
            self._undo_signals()
            raise
        connected_sessions.append(self)
        atexit.register(self.stop)  # land the parts, for whatever reason the interpreter ends

    def stop(self) -> None:
        """Land all parts and disconnect. Idempotent; signals do not shorten the landing.

        A LeRobot command that disconnects one device then disconnects the others, so all devices start landing now.
        """
        self._leave()
        try:
            with undisturbed(f"{self.device}: landing"):
                if under_a_command():
                    for other in connected_sessions:
                        with contextlib.suppress(
                            OSError
                        ):  # an error in the other control process must not prevent this landing
                            other._session.begin_stop()
                self._session.stop()
        finally:
            self._undo_signals()

    def _leave(self) -> None:
        atexit.unregister(self.stop)
        if self in connected_sessions:
            connected_sessions.remove(self)

    def discard(self) -> None:
        """End the session without landing, when its simulated world is discarded. Idempotent."""
        self._leave()
        try:
            self._session.discard()
        finally:
            self._undo_signals()

    def rearm(self) -> None:
        """Re-enable parts after a fault. Raises YamError: a part is still in fault, or has to be connected again."""
        self._session.rearm()
