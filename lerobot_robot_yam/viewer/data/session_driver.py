"""Drives the arms of a run config along recorded motions: a session of its own, and a thread that streams targets."""

import contextlib
import logging
import threading
from collections.abc import Callable, Mapping

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ActionError, LifeCycleError, YamError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.playback import Playback, replay
from lerobot_robot_yam.session.trajectory import Trajectory, columns_of
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.data.replay_driver import ReplayState

logger = logging.getLogger(__name__)

_PERIOD_S = 0.01
_RAMP_S = 0.4  # from full speed to rest, and back


class SessionDriver:
    """A `Driver` with arms of its own, which nobody else may drive.

    Args:
        configs: the arms by prefix, in the order of their columns.
        isolation: see `ArmSession`.

    Raises:
        ConfigError: they cannot be used together.
    """

    def __init__(self, configs: Mapping[str, ArmConfig], isolation: Isolation = "process"):
        self._names = {prefix: config.name for prefix, config in configs.items()}
        self._session = ArmSession(list(configs.values()), isolation)
        self.arms: Mapping[str, ResolvedArm] = {
            prefix: self._session.hardware(name) for prefix, name in self._names.items()
        }
        self._thread: threading.Thread | None = None
        self._paused = self._ending = self._energised = False
        self._share, self._text = 0.0, ""

    @property
    def state(self) -> ReplayState:
        """How it stands."""
        return ReplayState(self._busy, self._paused, self._energised, self._share, self._text)

    @property
    def _busy(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def replay(self, trajectories: Mapping[str, Trajectory]) -> None:
        """See `Driver`."""
        if trajectories.keys() != self.arms.keys():
            raise ActionError(
                f"the recording is of the arms {_list(trajectories)}, and the run config has {_list(self.arms)}"
            )
        whole = _together([trajectories[prefix] for prefix in self.arms], list(self.arms.values()))
        whole.check(list(self.arms.values()))
        self._begin(lambda: self._replay(whole), "energising the arms")

    def land(self) -> None:
        """See `Driver`."""
        self.end()
        self._join()
        self._begin(self._stop, "landing")

    def _begin(self, work: Callable[[], None], text: str) -> None:
        if self._busy:
            raise LifeCycleError("the arms are busy with a replay or a landing; end it first")
        self._paused = self._ending = False
        self._share, self._text = 0.0, text
        self._thread = threading.Thread(target=self._do, args=(work,), name="yam-view-replay")
        self._thread.start()

    def _do(self, work: Callable[[], None]) -> None:
        try:
            work()
        except YamError as error:
            self._text = str(error)
            self._hold()
        except Exception as error:
            logger.exception("the replay has failed")
            self._text = f"{type(error).__name__}: {error}"
            self._hold()

    def pause(self) -> None:
        """See `Driver`."""
        self._paused = True

    def resume(self) -> None:
        """See `Driver`."""
        self._paused = False

    def end(self) -> None:
        """See `Driver`."""
        self._ending = True

    def _clients(self) -> list[ArmClient]:
        return [self._session[name] for name in self._names.values()]

    def _wake(self) -> None:
        """Bring up arms that are off, and enable again those that have failed: a person has looked at them."""
        if self._session.running and all(client.mode() is Mode.OFF for client in self._clients()):
            self._session.stop()
        if not self._session.running:
            self._session.start()
        elif any(client.mode() is Mode.FAULT for client in self._clients()):
            self._session.rearm()
        self._energised = True

    def _replay(self, trajectory: Trajectory) -> None:
        self._wake()
        playback = replay(self._clients(), trajectory)
        self._text = "on the way to the first pose, then along the recording"
        self._text = self._stream(playback)
        self._hold()

    def _stream(self, playback: Playback) -> str:
        """Give targets until it has ended; time stands still for it while it is paused."""
        clock = self._session.clock
        then_s, place_s, rate = clock.now(), 0.0, 1.0
        while not self._ending:
            if playback.step(place_s):
                late = playback.late()
                return f"replayed; the arms hold{f', but {late} has not got there' if late else ''}"
            clock.sleep(_PERIOD_S)
            now_s = clock.now()
            most = (now_s - then_s) / _RAMP_S
            rate += float(np.clip((0.0 if self._paused else 1.0) - rate, -most, most))
            place_s, then_s = place_s + rate * (now_s - then_s), now_s
            self._share = min(place_s / playback.trajectory.seconds, 1.0)
        return "ended; the arms hold"

    def _hold(self) -> None:
        """Have every arm hold that can."""
        if not self._session.running:
            return
        for client in self._clients():
            with contextlib.suppress(YamError):
                client.hold()

    def _stop(self) -> None:
        self._session.stop()
        self._energised, self._text = False, "landed"

    def _join(self) -> None:
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """See `Driver`."""
        self.end()
        self._join()
        self._stop()


def _together(trajectories: list[Trajectory], arms: list[ResolvedArm]) -> Trajectory:
    """One trajectory of all arms. Raises ActionError: they have different times."""
    first = trajectories[0]
    if any(not np.array_equal(one.times_s, first.times_s) for one in trajectories):
        raise ActionError("the trajectories of the arms have different times")
    positions = np.concatenate([one.positions for one in trajectories], axis=1)
    source = first.source.partition(",")[0]
    return Trajectory(first.times_s, positions, columns_of(arms), source)


def _list(prefixes: Mapping[str, object]) -> str:
    return ", ".join(prefix.rstrip("_") or "one arm" for prefix in prefixes) or "none"
