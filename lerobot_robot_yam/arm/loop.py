"""The deadline loop: one thread owns the clock and every bus of a robot, so that all its arms tick together.

    send all → sleep while the wire works → collect and publish each → laws → sleep until the next deadline

Deadlines are absolute; after an overrun the loop starts anew from now: no burst, no drift.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from lerobot_robot_yam.arm.arm_parts import GuardedArm
from lerobot_robot_yam.arm.blocks import ControllerBlocks
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.controller import ArmController
from lerobot_robot_yam.arm.estop import EmergencyStop
from lerobot_robot_yam.arm.guard import WorkspaceGuard
from lerobot_robot_yam.arm.lifecycle import ENERGISED, Mode
from lerobot_robot_yam.arm.policy import POLICY, Response
from lerobot_robot_yam.arm.statistics import LoopStatistics
from lerobot_robot_yam.errors import BusError, LifeCycleError, MotorError

logger = logging.getLogger(__name__)

_STRAGGLER_S = 0.0008  # how long beyond the expected wire time a reply is waited for
_EARLY_S = 0.0002  # before the wire is through: what has come is decoded while the last frames travel
_WAKE_UP_S = 0.00006  # what a sleep takes longer than asked, typically
_ENDED = (Mode.OFF, Mode.OFFLINE)
_MOST_DT_S = 0.012  # after a pause the set-points go on from where they were, not in one leap
_GUARDED = (Mode.HOLD, Mode.TRACK)  # a landing ends where the arm touches itself


class ControlLoop:
    """Runs the arms of one robot until all are off.

    Args:
        controllers: inspected, not yet energised.
        blocks: in the same order.
        rate_hz: ticks per second; 0 runs as fast as the wire allows.
        workspace: of arms that are to be driven; what only lands them needs none.
    """

    def __init__(
        self,
        controllers: Sequence[ArmController],
        blocks: Sequence[ControllerBlocks],
        rate_hz: float,
        workspace: WorkspaceGuard | None = None,
    ):
        self._controllers = controllers
        self._blocks = blocks
        self._period_s = 1.0 / rate_hz if rate_hz > 0 else 0.0
        self._wire_s = max(c.chain.expected_wire_s for c in controllers)
        self.statistics = LoopStatistics(self._period_s)
        self._stop = EmergencyStop()
        self._workspace = workspace
        self._clock = controllers[0].chain.clock
        self._failure = ""  # of the bring-up

    def start(self) -> None:
        """Energise every arm, or none.

        Raises:
            YamError: names what failed.
        """
        energised: list[ArmController] = []
        try:
            for controller, blocks in zip(self._controllers, self._blocks, strict=True):
                blocks.publish(self._clock.now(), 0)  # a stand-by has to know the arm before it is energised
                controller.energise()
                energised.append(controller)
        except BaseException:
            for controller in energised:  # they were limp a moment ago and have not moved
                controller.abandon()
            raise

    def run(self, on_ready: Callable[[], None] = lambda: None, must_land: Callable[[], bool] = lambda: False) -> None:
        """Tick until every arm is off; see `ticks`."""
        for _ in self.ticks(on_ready, must_land):
            pass

    def ticks(
        self, on_ready: Callable[[], None] = lambda: None, must_land: Callable[[], bool] = lambda: False
    ) -> Iterator[None]:
        """The same, tick by tick: each step sleeps until the next deadline and ticks once.

        Args:
            on_ready: called once, when every arm has left bring-up.
            must_land: asked every tick; once it says True all arms land and the loop ends.

        Raises:
            YamError: bring-up failed. The arms have landed then.
        """
        ready = landing = False
        tick = 0
        clock = self._clock
        last = deadline = clock.now()
        for blocks in self._blocks:
            blocks.publish(last, tick)
        while True:
            now = clock.now()
            self.statistics.tick(now)
            landing = landing or bool(self._failure) or must_land()
            if landing:
                for controller in self._controllers:
                    controller.end(now)
            if not all(blocks.owned for blocks in self._blocks):
                raise LifeCycleError("another process has taken the arms over; this one leaves them alone")
            self._exchange(now)
            tick += 1
            for controller, blocks in zip(self._controllers, self._blocks, strict=True):
                self._guard(controller, self._measure, blocks, now + self._wire_s + _STRAGGLER_S, tick)
            self._tell_peers()
            now = clock.now()
            dt, last = min(now - last, _MOST_DT_S), now
            stopped = self._stopped(now)
            for controller, blocks in zip(self._controllers, self._blocks, strict=True):
                self._guard(controller, self._decide, blocks, now, stopped)
            self._advance(now, dt)
            for controller, blocks in zip(self._controllers, self._blocks, strict=True):
                self._guard(controller, self._command, blocks, now, dt, tick)
            if not ready:
                ready = self._bring_up(on_ready)
            if all(controller.mode in _ENDED for controller in self._controllers):
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

    def _guard(self, controller: ArmController, work: Callable[..., None], *arguments: Any) -> None:
        """Whatever goes wrong with an arm: one that nobody commands falls."""
        try:
            work(controller, *arguments)
        except Exception as error:
            controller.fail(error)

    def _tell_peers(self) -> None:
        """The other arms answer trouble as the policy says."""
        for controller in self._controllers:
            trouble = controller.take_news()
            if trouble is not None and POLICY[trouble].peer is Response.HOLD:
                for peer in self._controllers:
                    if peer is not controller:
                        peer.halt(f"{controller.name} is in trouble: {trouble}")

    def _stopped(self, now: float) -> bool:
        """Whether the emergency stop is latched; a handle's button and an effort limit latch it."""
        for controller in self._controllers:
            reason = controller.stop_reason(now)
            if reason:
                try:
                    self._stop.latch(reason)
                except OSError as error:  # at least these arms hold
                    logger.critical("emergency stop, until you connect again: %s (%s)", reason, error)
        return self._stop.latched

    def _measure(self, controller: ArmController, blocks: ControllerBlocks, deadline: float, tick: int) -> None:
        """Publish an arm's state as soon as it is complete: a sample ages."""
        if controller.mode not in _ENDED:
            try:
                controller.collect(deadline)
                controller.measure(self._clock.now())
            except BusError as error:
                controller.lose_bus(error, self._clock.now())
        blocks.publish(self._clock.now(), tick)

    @staticmethod
    def _decide(controller: ArmController, blocks: ControllerBlocks, now: float, stopped: bool) -> None:
        if controller.mode not in _ENDED:
            blocks.take(now)
            controller.decide(now, stopped)

    def _advance(self, now: float, dt: float) -> None:
        """Move the set-points on, clear of each other and of what the workspaces forbid."""
        try:
            if self._workspace is None:
                for controller in self._controllers:
                    controller.setpoint.advance(now, dt)
            else:
                self._advance_guarded(self._workspace, now, dt)
        except Exception as error:  # whoever is to blame: no arm may be left without commands
            for controller in self._controllers:
                if controller.mode not in _ENDED:
                    controller.fail(error)

    def _advance_guarded(self, workspace: WorkspaceGuard, now: float, dt: float) -> None:
        controllers = self._controllers
        known = [c.hardware.has_gripper and c.mode is not Mode.BRING_UP for c in controllers]
        workspace.open_grippers([float(c.q[-1]) if k else 1.0 for c, k in zip(controllers, known, strict=True)])
        guarded = [controller.mode in _GUARDED for controller in controllers]
        setpoints, measured = [c.setpoint for c in controllers], [c.q for c in controllers]
        verdict = workspace.advance(setpoints, measured, guarded, now, dt)
        for index, controller in enumerate(controllers):
            controller.held_back(verdict.message(index) if verdict.blocked[index] else "")

    @staticmethod
    def _command(controller: ArmController, blocks: ControllerBlocks, now: float, dt: float, tick: int) -> None:
        if controller.mode not in _ENDED:
            controller.command(now, dt)
        if controller.mode is not blocks.published_mode:
            blocks.publish(now, tick)  # who waits for it looks at once, and of the end there is no next tick

    def _exchange(self, now: float) -> None:
        """Send to all arms; come back when the wire should be through, most replies decoded already."""
        active = [c for c in self._controllers if c.mode not in _ENDED]
        for controller in active:
            try:
                _send(controller)
            except BusError as error:
                controller.lose_bus(error, now)
            except Exception as error:  # not even that: the other arms are to be held
                controller.fail(error)
        self._clock.sleep(max(0.0, now + self._wire_s - _EARLY_S - self._clock.now()))
        for controller in active:
            if controller.mode not in _ENDED:
                try:
                    controller.chain.drain()
                except BusError as error:
                    controller.lose_bus(error, now)
        self._clock.sleep(max(0.0, now + self._wire_s - _WAKE_UP_S - self._clock.now()))

    def _bring_up(self, on_ready: Callable[[], None]) -> bool:
        """True when all arms have left bring-up; when one fails they all land, since a hand may have let go by now."""
        modes = [controller.mode for controller in self._controllers]
        if Mode.FAULT in modes and not self._failure:
            self._failure = self._controllers[modes.index(Mode.FAULT)].message
            logger.error("bring-up failed, landing: %s", self._failure)
        if Mode.BRING_UP in modes or self._failure:
            return False
        on_ready()
        return True

    def close(self, stand_by: bool = False) -> None:
        """Log how the loop did and remove the state blocks.

        Args:
            stand_by: there is one; it takes over what is still in the air, for which it needs the block.
        """
        lost = {c.name: int(c.chain.lost.sum()) for c in self._controllers}
        logger.info("control loop: %s; lost replies %s", self.statistics.summary(), lost)
        for controller, blocks in zip(self._controllers, self._blocks, strict=True):
            if controller.mode is Mode.OFF:
                blocks.publish(self._clock.now(), 0)  # a stand-by may still look at it
            blocks.close(remove=not (stand_by and controller.mode in ENERGISED))


def _send(controller: ArmController) -> None:
    try:
        controller.send()
    except BusError:
        raise
    except Exception as error:  # a command that cannot be packed: the last good one instead
        controller.fail(error)
        controller.send()


def guard(controllers: Sequence[ArmController]) -> WorkspaceGuard | None:
    """What keeps these arms clear of things and each other; None when nothing is forbidden."""
    if not any(c.config.workspace.limits_anything for c in controllers):
        return None
    return WorkspaceGuard(
        [GuardedArm(c.name, c.hardware.arm, c.hardware.gripper, c.config.workspace) for c in controllers]
    )


def build(configs: Sequence[ArmConfig], keys: Sequence[str], buses: Sequence) -> ControlLoop:
    """Controllers on open buses, inspected: everything that can be refused without torque is refused here.

    Raises:
        YamError: names the part that is not as configured.
    """
    controllers = [ArmController(config, bus) for config, bus in zip(configs, buses, strict=True)]
    for controller in controllers:
        controller.inspect()
    blocks: list[ControllerBlocks] = []
    try:
        for controller, key in zip(controllers, keys, strict=True):
            blocks.append(ControllerBlocks(controller, key))
        return ControlLoop(controllers, blocks, configs[0].rate_hz, guard(controllers))
    except BaseException:
        for made in blocks:
            made.close(remove=True)
        raise
