"""The way of a base to OFF, over ticks: first the torque of the rail is cut, once its brake holds; then that of all."""

from collections.abc import Generator

from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.mobile.base_motors import BaseMotors
from lerobot_robot_yam.control.mobile.rail_controller import RailController
from lerobot_robot_yam.control.mobile.rail_monitor import Finding
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode


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
