"""The control loop: one thread owns the clock and all buses of a robot, so that all arms tick together.

    send all → sleep during transmission → collect and publish each arm → laws → sleep until the next deadline

Deadlines are absolute; after an overrun the deadlines restart from the present time: no burst, no drift.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.loop_timing import MOST_DT_S, LoopStatistics
from lerobot_robot_yam.control.part_controller import Blocks, Controller
from lerobot_robot_yam.control.preflight.arm_inspection import refuse_stopped
from lerobot_robot_yam.errors import LifeCycleError, MotorError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import RESPONSES, Response
from lerobot_robot_yam.state.modes import ENERGISED, Mode

if TYPE_CHECKING:
    from lerobot_robot_yam.control.safety.collision_guard import WorkspaceGuard

logger = logging.getLogger(__name__)

_STRAGGLER_S, _STRAGGLER_MOST_S = 0.0008, 0.002  # minimum and maximum wait for late replies, s
_MOMENT_S = 0.0004  # minimum wait for replies after a late wake-up of this process, s
_EARLY_S = 0.0002  # lead time of decoding before the bus is idle, s, while the last frames are in transit
_WAKE_UP_S = 0.00006  # typical wake-up delay after a sleep, s
_LAWS_S = 0.0008  # time reserved for states and laws, s: twice the need of two arms on an idle machine
_BREATH_S = 0.0001  # minimum sleep per tick, s: the kernel stops real-time processes that never sleep, for 50 ms
_STOPPED_EARLY = (
    "the emergency stop was latched while the arms came up; they land when it is released: look at them, then "
    "`yam-estop release`, and connect again"
)
_GUARDED = (Mode.HOLD, Mode.TRACK)  # modes with a workspace guard; not LAND: a folded arm touches itself


class ControlLoop:
    """Loop that runs all arms of one robot until all are off.

    Args:
        controllers: one per arm, inspected, not yet energised.
        blocks: shared blocks of each arm, in the same order.
        rate_hz: ticks per second; 0: as fast as the bus allows.
        workspace: guard against collisions; None: no guard, as in a loop that only lands arms.
        stop: emergency stop to obey; None: this user's emergency stop.
    """

    def __init__(
        self,
        controllers: Sequence[Controller],
        blocks: Sequence[Blocks],
        rate_hz: float,
        workspace: "WorkspaceGuard | None" = None,
        stop: EmergencyStop | None = None,
    ):
        self._controllers = controllers
        self._blocks = blocks
        self._period_s = 1.0 / rate_hz if rate_hz > 0 else 0.0
        self._wire_s = max(c.wire_s for c in controllers)
        self.statistics = LoopStatistics(self._period_s)
        self._stop = stop or EmergencyStop()
        self._workspace = workspace
        self._clock = controllers[0].clock
        self._failure = ""  # reason why bring-up failed
        self._ready = True  # whether no arm is in bring-up, as in a stand-by
        self._tick = 0
        self._last = 0.0  # time of the last set-point step, s

    def start(self) -> None:
        """Energise all arms, or leave all arms limp. Raises YamError: bring-up failed; the message says why."""
        self._ready = False
        begun: list[tuple[Controller, Blocks]] = []

        try:
            for controller, blocks in zip(self._controllers, self._blocks, strict=True):
                begun.append((controller, blocks))
                for _ in controller.energise():
                    self._start_tick(begun)
        except BaseException:
            for controller, _ in begun:  # cutting torque is safe: these arms were limp and have not moved
                controller.abandon()
            self.run()
            raise

    def _start_tick(self, begun: Sequence[tuple[Controller, Blocks]]) -> None:
        """Run one tick of the start: command and publish the arms in `begun`; the last one is being energised."""
        self._tick += 1
        begin = self._clock.now()
        refuse_stopped(begun[-1][0].name, self._stop)
        for controller, blocks in begun:
            blocks.publish(begin, self._tick)
            controller.start_send()
        self._clock.sleep(self._wire_s)
        for controller, _ in begun:
            controller.start_receive(begin + self._wire_s + _STRAGGLER_MOST_S)
        self._clock.sleep(max(0.0, begin + self._period_s - self._clock.now()))

    def run(
        self, on_ready: Callable[[str], None] = lambda _: None, must_land: Callable[[], bool] = lambda: False
    ) -> None:
        """Tick until every arm is off; see `ticks`."""
        for _ in self.ticks(on_ready, must_land):
            pass

    def ticks(
        self, on_ready: Callable[[str], None] = lambda _: None, must_land: Callable[[], bool] = lambda: False
    ) -> Iterator[None]:
        """Tick until every arm is off, as a generator: each step sleeps until the next deadline and ticks once.

        Args:
            on_ready: called once, with "" when every arm has left bring-up, or with the reason if bring-up fails and
                the arms begin to land.
            must_land: called every tick; once the result is True, all arms land and the loop ends.

        Raises:
            YamError: bring-up failed, and the arms have landed.
        """
        landing = False
        clock = self._clock
        self._last = deadline = clock.now()
        for blocks in self._blocks:
            blocks.publish(deadline, self._tick)
        while True:
            now = clock.now()
            self.statistics.tick(now)
            landing = landing or bool(self._failure) or must_land()
            if landing:
                for controller in self._controllers:
                    controller.end(now)
            if not all(blocks.owned for blocks in self._blocks):
                raise LifeCycleError("another process has taken the arms over; this one leaves them alone")
            self._send_all()
            patient_until = self._patience(clock.now() + self._wire_s, deadline + self._period_s)
            self._await_wire(now)
            self._think(on_ready, max(patient_until, clock.now() + _MOMENT_S))
            if all(controller.status.ended for controller in self._controllers):
                if self._failure:
                    raise MotorError(self._failure)
                return
            yield
            deadline += self._period_s
            now = clock.now()
            if now < deadline:
                clock.sleep(deadline - now)
            else:
                self.statistics.overruns += self._period_s > 0
                deadline = now

    def _think(self, on_ready: Callable[[str], None], collect_until: float) -> None:
        """Process replies: publish states for the callers, and compute commands for the next `_send_all`.

        Args:
            on_ready: see `ticks`.
            collect_until: time at which waiting for replies ends, s.
        """
        self._tick += 1
        arms = list(zip(self._controllers, self._blocks, strict=True))
        for controller, blocks in arms:
            self._guard(controller, self._measure, blocks, collect_until, self._tick)
        self._tell_peers()
        now = self._clock.now()
        dt, self._last = min(now - self._last, MOST_DT_S), now
        stopped = self._stopped(now)
        for controller, blocks in arms:
            self._guard(controller, self._decide, blocks, now, stopped)
        self._advance(now, dt)
        for controller, blocks in arms:
            self._guard(controller, self._command, blocks, now, dt, self._tick)
        if not self._ready:
            self._ready = self._bring_up(on_ready)

    def _guard(self, controller: Controller, work: Callable[..., None], *arguments: Any) -> None:
        """Run `work` for one part; on an exception, hold that part, since an arm without commands falls."""
        try:
            work(controller, *arguments)
        except Exception as error:
            if not controller.status.ended:
                controller.fail(error)

    def _tell_peers(self) -> None:
        """Let the other arms respond to an arm's new fault according to the fault table."""
        for controller in self._controllers:
            trouble = controller.take_news()
            if trouble is not None and RESPONSES[trouble].peer is Response.HOLD:
                for peer in self._controllers:
                    if peer is not controller:
                        peer.halt(controller.status)

    def _stopped(self, now: float) -> bool:
        """Latch the emergency stop if an arm has a stop reason; return whether the emergency stop is latched."""
        for controller in self._controllers:
            reason = controller.stop_reason(now)
            if reason:
                try:
                    self._stop.latch(reason, controller.name)
                except OSError as error:  # without a latch file at least these arms stop
                    logger.critical("emergency stop, until you connect again: %s (%s)", reason, error)
        return self._stop.latched

    def _measure(self, controller: Controller, blocks: Blocks, collect_until: float, tick: int) -> None:
        """Read one arm's state and publish it immediately, since samples age."""
        if not controller.status.ended:
            controller.collect(collect_until)
            controller.measure(self._clock.now())
        blocks.publish(self._clock.now(), tick)

    @staticmethod
    def _decide(controller: Controller, blocks: Blocks, now: float, stopped: bool) -> None:
        if not controller.status.ended:
            controller.status.stopped = stopped
            blocks.read_target(now)
            controller.decide(now)

    def _advance(self, now: float, dt: float) -> None:
        """Step the set-points and plans; those of the arms with the workspace guard if there is one."""
        guarded: list[ArmController] = []
        for controller in self._controllers:
            if self._workspace is not None and isinstance(controller, ArmController):
                guarded.append(controller)
            else:
                self._guard(controller, lambda part: part.advance(now, dt))
        if self._workspace is None:
            return
        try:
            self._advance_guarded(self._workspace, guarded, now, dt)
        except Exception as error:  # whichever arm caused the error, all arms need commands
            for arm in guarded:
                if not arm.status.ended:
                    arm.fail(error)

    @staticmethod
    def _advance_guarded(
        workspace: "WorkspaceGuard", controllers: Sequence[ArmController], now: float, dt: float
    ) -> None:
        arms = [controller.actuation for controller in controllers]
        workspace.open_grippers([arm.opening for arm in arms])
        guarded = [controller.mode in _GUARDED for controller in controllers]
        setpoints, measured = [arm.setpoint for arm in arms], [arm.q for arm in arms]
        verdict = workspace.advance(setpoints, measured, guarded, now, dt)
        for index, controller in enumerate(controllers):
            controller.held_back(verdict.message(index) if verdict.blocked[index] else "")

    def _command(self, controller: Controller, blocks: Blocks, now: float, dt: float, tick: int) -> None:
        if not controller.status.ended:
            controller.compute_command(now, dt)
        if controller.mode is not blocks.published_mode:
            blocks.publish(self._clock.now(), tick)  # so that a waiting caller sees the new mode at once

    def _active(self) -> list[Controller]:
        return [controller for controller in self._controllers if not controller.status.ended]

    def _send_all(self) -> None:
        for controller in self._active():
            controller.send()

    @staticmethod
    def _patience(through_s: float, next_s: float) -> float:
        """Return the deadline for replies. through_s: time when the bus becomes idle; next_s: next tick's deadline."""
        return min(max(through_s + _STRAGGLER_S, next_s - _LAWS_S), through_s + _STRAGGLER_MOST_S)

    def _await_wire(self, sent_s: float) -> None:
        """Wait until the bus should be idle after the frames sent at `sent_s`; decode most replies meanwhile."""
        through_s = sent_s + self._wire_s
        self._clock.sleep(max(_BREATH_S, through_s - _EARLY_S - self._clock.now()))
        for controller in self._active():
            controller.drain()
        left_s = through_s - _WAKE_UP_S - self._clock.now()
        if left_s > 0.0:
            self._clock.sleep(left_s)

    def _bring_up(self, on_ready: Callable[[str], None]) -> bool:
        """Return whether all arms have left bring-up; if one fails, all land, since hands may no longer help."""
        modes = [controller.mode for controller in self._controllers]
        if not self._failure:
            if Mode.FAULT in modes:
                self._failure = self._controllers[modes.index(Mode.FAULT)].status.message
            elif Mode.STOPPED in modes:
                self._failure = _STOPPED_EARLY
            if self._failure:
                logger.error("bring-up failed, landing: %s", self._failure)
                on_ready(self._failure)
        if Mode.BRING_UP in modes or self._failure:
            return False
        on_ready("")
        return True

    def close(self, stand_by: bool = False) -> None:
        """Log the loop's statistics and remove the state blocks.

        Args:
            stand_by: whether a stand-by exists, which takes over energised arms and needs their blocks.
        """
        lost = {c.name: c.lost for c in self._controllers}
        logger.info("control loop: %s; lost replies %s", self.statistics.summary(), lost)
        for controller, blocks in zip(self._controllers, self._blocks, strict=True):
            for what in controller.complaints():
                logger.warning(what)
            if controller.mode is Mode.OFF:
                blocks.publish(self._clock.now(), 0)  # a stand-by may still read the block
            controller.close()
            blocks.close(remove=not (stand_by and controller.mode in ENERGISED))
