"""What takes a base several ticks: re-arming after a fault, and the way to OFF.

On the way to OFF, first the torque of the rail is cut, once its brake holds; then that of all motors.
"""

import logging
from collections.abc import Callable, Generator

import numpy as np

from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.fault_response import RELEASE_FIRST
from lerobot_robot_yam.control.mobile.base_motors import BaseMotors
from lerobot_robot_yam.control.mobile.rail_controller import RailController
from lerobot_robot_yam.control.mobile.rail_monitor import Finding
from lerobot_robot_yam.errors import LifeCycleError, YamError
from lerobot_robot_yam.state.faults import RESPONSES, Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited

logger = logging.getLogger(__name__)


class BaseRearm:
    """Re-arming of one base. restart: plans anew, once all motors are enabled."""

    def __init__(self, status: ArmStatus, motors: BaseMotors, restart: Callable[[], None]):
        self._status, self._motors, self._restart = status, motors, restart
        self._work: Generator[None, None, None] | None = None

    def begin(self) -> None:
        """Begin, or only accept targets again if there is no fault. Raises LifeCycleError: it has to connect again."""
        status = self._status
        if status.mode is Mode.LAND or status.must_land:
            raise LifeCycleError(f"{status.name}: {status.message or 'it has been told to stop'}; connect again")
        if status.mode is not Mode.FAULT:
            status.halted = False
            return
        assert status.trouble is not None
        if status.stopped:  # re-arming releases the brake of the rail
            raise LifeCycleError(f"{status.name}: {status.message}; {RELEASE_FIRST}")
        rule = RESPONSES[status.trouble]
        if not rule.in_place:
            raise LifeCycleError(f"{status.name}: {status.message}; {rule.rearm}")
        failed = np.flatnonzero(self._motors.watch.check(self._motors.chain.clock.now()).bad).tolist()
        self._work, status.rearming = self._motors.enable(failed), True

    def advance(self) -> None:
        """Advance by one tick; a failure is the answer to the request."""
        work, self._work, self._status.rearming = self._work, None, False
        if work is None:
            return
        try:
            next(work)
        except StopIteration:
            self._end()
        except YamError as error:
            self._status.refusal = str(error)
        else:
            self._work, self._status.rearming = work, True

    def _end(self) -> None:
        status = self._status
        self._restart()
        status.enter(Mode.HOLD)
        status.trouble, status.message, status.halted, status.limited = None, "", False, Limited.NOTHING
        logger.info("%s: re-armed", status.name)


class BaseExit:
    """Way to OFF of one base."""

    def __init__(self, status: ArmStatus, motors: BaseMotors, rail: RailController | None):
        self._status, self._motors, self._rail = status, motors, rail
        self._steps: Generator[None, None, Finding | None] = self._leave()

    def begin(self) -> Finding | None:
        """Begin, and take the first step; see `advance`."""
        self._status.check(Mode.OFF)
        self._status.letting_go, self._steps = True, self._leave()
        return self.advance()

    def advance(self) -> Finding | None:
        """Take one step; the last one enters OFF. Return why the base has to go on holding instead."""
        try:
            next(self._steps)
            return None
        except StopIteration as end:
            finding: Finding | None = end.value
            if finding is None:
                self._status.enter(Mode.OFF)
        except Exception as error:  # motors that nobody has switched off must stay commanded
            finding = Trouble.INTERNAL_ERROR, f"internal error, holding: {error!r}"
        self._status.letting_go = False
        return finding

    def _leave(self) -> Generator[None, None, Finding | None]:
        finding = None if self._rail is None else (yield from self._rail.let_go())
        if finding is None:
            yield from self._motors.switch_off()
        return finding
