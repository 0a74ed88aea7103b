"""Arms that run on this computer, found and read through their shared state blocks. Nothing is written or requested."""

import contextlib
import dataclasses
import logging
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.config import VIRTUAL, ArmConfig, LeadArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import StaleStateError, YamError
from lerobot_robot_yam.state.about import read_about
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import ENERGISED, Mode
from lerobot_robot_yam.state.records import STATE_DTYPE
from lerobot_robot_yam.system.runtime_dirs import STATE, sessions
from lerobot_robot_yam.system.runtime_files import runtime_dir, slug
from lerobot_robot_yam.system.shared_block import SharedBlock

logger = logging.getLogger(__name__)

_LOOK_S = 0.5
_AGE_S = 0.25  # maximum state age for arms whose config is unknown, s
_LOST_S = 60.0  # how long the page warns that an arm was left energised, s
_FIELDS = {field.name for field in dataclasses.fields(LeadArmConfig)}


class WatchedArm:
    """Arm of any session on this computer.

    Attributes:
        key: channel key.
        process: process that drives the arm.
        hardware: profiles and limits; None if the session does not publish them.
        state: newest state read; None before the first one.
        age_s: age of `state` at the time of the last `read`, s.
    """

    def __init__(self, directory: Path, key: str, process: str):
        self.key, self.process = key, process
        self.hardware = _hardware(read_about(directory, key))
        self.state: ArmState | None = None
        self.age_s = 0.0
        self._block = SharedBlock(directory / f"{STATE}{key}", STATE_DTYPE, create=False)

    @property
    def name(self) -> str:
        """Name of the arm with its channel, for messages."""
        return self.key if self.hardware is None else f"{self.hardware.name} ({self.key})"

    @property
    def rig(self) -> str | None:
        """Name of the arm's virtual rig, as in the rig's file names; None for a real arm."""
        if self.hardware is None or self.hardware.config.interface != VIRTUAL:
            return None
        return self.key.removesuffix(f".{slug(self.hardware.config.channel)}")

    @property
    def current(self) -> bool:
        """Whether the arm's session still runs, with no newer session on the channel."""
        return self._block.current

    @property
    def stale(self) -> bool:
        """Whether the newest state of the arm's control loop is too old."""
        limit_s = _AGE_S if self.hardware is None else self.hardware.config.max_state_age_s
        return self.state is not None and self.state.mode is not Mode.OFF and self.age_s > limit_s

    def read(self, now_s: float) -> None:
        """Read the newest state and update its age. `now_s`: time of the monotonic clock."""
        payload = self._block.glance_bytes()
        if payload is not None:
            self.state = ArmState(payload)
        if self.state is not None:
            self.age_s = now_s - self.state.published_s

    def close(self) -> None:
        """Release the shared memory. Idempotent."""
        self._block.close(remove=False)


class WatchedArms:
    """All running arms. `arms`: channel key → arm. Call `update` once per round."""

    def __init__(self) -> None:
        self.arms: dict[str, WatchedArm] = {}
        self._lost: dict[str, tuple[str, float]] = {}
        self._looked_s = -_LOOK_S

    def update(self, now_s: float) -> None:
        """Read the states of all arms. Every `_LOOK_S`, also search for sessions that have started or ended."""
        if now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            self._look(now_s)
        for arm in self.arms.values():
            arm.read(now_s)

    def lost(self, now_s: float) -> list[str]:
        """Return a warning for each arm whose session ended while the arm was energised.

        A warning ends after `_LOST_S`, or when a new session starts on the channel.
        """
        return [line for line, since_s in self._lost.values() if now_s - since_s < _LOST_S]

    def _look(self, now_s: float) -> None:
        directory = runtime_dir()
        running = sessions(directory)
        for key, arm in list(self.arms.items()):
            if running.get(key) != arm.process or not arm.current:
                arm.read(now_s)
                if arm.state is not None and arm.state.mode in ENERGISED:
                    text = f"{arm.name}: its session has ended in {arm.state.mode.name}, without landing"
                    self._lost[key] = f"{text}: look at the arm", now_s
                arm.close()
                del self.arms[key]
        for key, process in running.items():
            if key not in self.arms:
                with contextlib.suppress(FileNotFoundError, StaleStateError):  # the session is starting or ending
                    self.arms[key] = WatchedArm(directory, key, process)
                    self._lost.pop(key, None)

    def close(self) -> None:
        """Release the shared memory of all arms. Idempotent."""
        for arm in self.arms.values():
            arm.close()
        self.arms.clear()


def _hardware(about: dict[str, Any] | None) -> ResolvedArm | None:
    if about is None:
        return None
    leads = about.get("lead") is not None or about.get("passive") is not None
    fields = {key: value for key, value in about.items() if key in _FIELDS and (leads or value is not None)}
    try:
        return ResolvedArm((LeadArmConfig if leads else ArmConfig)(**fields))
    except (YamError, TypeError, OSError) as error:
        logger.warning("%s is shown without its shape: %s", about.get("name"), error)
        return None
