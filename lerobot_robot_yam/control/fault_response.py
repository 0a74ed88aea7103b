"""Response of an arm to faults, its own or the other arm's, and re-arming. Fault table: `state.faults`."""

import logging
from collections.abc import Generator

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.control.bring_up import BringUp
from lerobot_robot_yam.control.float_monitor import FloatMonitor
from lerobot_robot_yam.control.landing_response import LandingResponse
from lerobot_robot_yam.control.rearm import Rearm
from lerobot_robot_yam.errors import BusError, LifeCycleError, YamError
from lerobot_robot_yam.state.faults import RESPONSES, Response, Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited

logger = logging.getLogger(__name__)

RELEASE_FIRST = "the emergency stop is latched: look at the arms, then `yam-estop release`"


class FaultResponse:
    """Fault responses and re-arming of one arm."""

    def __init__(
        self, rearm: Rearm, actuation: Actuation, landing: LandingResponse, bring_up: BringUp, floating: FloatMonitor
    ):
        self._actuation, self._status = actuation, actuation.status
        self._landing, self._bring_up, self._floating = landing, bring_up, floating
        self._rearm = rearm
        self._rearming: Generator[None] | None = None  # re-arming in progress
        self._halted_afloat = False
        self._news: Trouble | None = None
        self._peer: ArmStatus | None = None  # arm whose fault halted this one

    def suffer(self, trouble: Trouble, message: str, now: float) -> None:
        """Respond to a fault according to the fault table, and record the fault for the other arms.

        An arm in FAULT or LAND, or one whose torque is being cut, ignores further faults.
        """
        arm, status = self._actuation, self._status
        if status.mode in (Mode.FAULT, Mode.LAND) or status.letting_go:
            return
        logger.error("%s (%s): %s: %s", arm.name, arm.config.channel, trouble, message)
        self._news = trouble
        if RESPONSES[trouble].arm is Response.LAND:
            self._landing.land(now, trouble, message)
            return
        status.trouble, status.message = trouble, message
        status.must_land = False
        arm.stop_moving()
        arm.enter(Mode.FAULT)

    def fail(self, error: Exception) -> None:
        """Hold with the last commands at zero speed after an internal error."""
        arm, status = self._actuation, self._status
        if status.ended or status.letting_go:
            logger.critical("%s: internal error; it has no torque", arm.name, exc_info=error)
            return
        if status.mode is not Mode.FAULT:
            message = f"internal error, holding: {error!r}"
            if message != status.message:  # else the same error has ended a landing, which is tried again
                logger.critical("%s: internal error, holding", arm.name, exc_info=error)
            status.trouble, status.message = Trouble.INTERNAL_ERROR, message
            self._news = status.trouble
            status.enter(Mode.FAULT)
            arm.stop_moving()
            arm.use_gains()
        self._landing.cancel()
        arm.repeat()

    def lose_bus(self, error: BusError, now: float) -> None:
        """Respond to a failed send; meanwhile the motors obey the last command until their own watchdogs act."""
        trouble = self._actuation.bus_loss.note(error, now)
        if trouble is not None:
            self.suffer(trouble, str(error), now)

    def take_news(self) -> Trouble | None:
        """Return the fault that has occurred since the last call, or None."""
        news, self._news = self._news, None
        return news

    def halt(self, peer: ArmStatus) -> None:
        """Hold, and refuse targets until both arms are re-armed, because `peer` is in fault."""
        status = self._status
        self._peer = peer
        if status.mode in (Mode.HOLD, Mode.TRACK, Mode.FLOAT, Mode.STOPPED, Mode.BRING_UP):
            logger.warning("%s: holds: %s is in trouble: %s", status.name, peer.name, peer.trouble)
            self._halted_afloat |= status.floats and status.afloat
            status.halted = True
            status.limited |= Limited.PEER
            if status.mode in (Mode.TRACK, Mode.FLOAT):
                self._actuation.hold_here()

    def rearm(self) -> None:
        """Begin to re-enable failed motors and hold the measured pose; `advance` continues while `status.rearming`.

        An arm whose own fault has ended keeps holding while the other arm is in fault.

        Raises:
            LifeCycleError: the fault requires a new connection, the arm lands, the emergency stop is latched, the arm
                would not float safely, or the arm holds because another arm is in fault.
        """
        arm, status = self._actuation, self._status
        if status.mode is Mode.LAND or status.must_land:
            why = status.message or "it has been told to land"
            raise LifeCycleError(f"{arm.name}: {why}; let it land, then connect again")
        if status.mode is Mode.FAULT:
            self._check_rearm()
            self._rearming, status.rearming = self._rearm_motors(), True
            return
        if status.halted and self._peer is not None and self._peer.trouble is not None:
            why = f"{self._peer.name} is in trouble: {self._peer.trouble}"
            raise LifeCycleError(f"{arm.name}: holds as long as {why}; re-arm that arm first, or connect again")
        self._release()

    def advance(self) -> None:
        """Advance re-arming by one tick. After a failure `status.refusal` has the reason, and working motors hold."""
        work, self._rearming = self._rearming, None  # an internal error ends the re-arming, too
        if work is None:
            return
        self._status.rearming = False
        try:
            next(work)
        except StopIteration:
            return
        except Exception as error:
            self._status.refusal = str(error)
            if not isinstance(error, YamError):
                raise
            return
        self._rearming, self._status.rearming = work, True

    def _release(self) -> None:
        """Accept targets again, unless the other arm is in fault."""
        arm, status = self._actuation, self._status
        if self._halted_afloat and status.mode is Mode.HOLD:
            self._floating.check(arm.name)
            arm.enter(Mode.FLOAT)
        logger.info("%s: re-armed", arm.name)
        peer, self._peer = self._peer, None
        status.halted, self._halted_afloat = False, False
        status.trouble, status.message, status.limited = None, "", Limited.NOTHING
        if peer is not None and peer.trouble is not None:  # the peer is still in fault
            self.halt(peer)

    def _check_rearm(self) -> None:
        arm, status = self._actuation, self._status
        assert status.trouble is not None
        if status.stopped:
            raise LifeCycleError(f"{arm.name}: {status.message}; {RELEASE_FIRST}")
        if not RESPONSES[status.trouble].in_place:
            raise LifeCycleError(f"{arm.name}: {status.message}; {RESPONSES[status.trouble].rearm}")
        if status.floats:
            self._floating.check(arm.name)

    def _rearm_motors(self) -> Generator[None]:
        arm, status = self._actuation, self._status
        failed = yield from self._rearm.run()
        if arm.gripper is not None and (arm.hardware.n - 1 in failed or arm.gripper.stops is None):
            self._bring_up.after = Mode.HOLD
            arm.gripper.begin()
            arm.enter(Mode.BRING_UP)
        else:
            arm.enter(Mode.FLOAT if status.floats else Mode.HOLD)
        self._release()
