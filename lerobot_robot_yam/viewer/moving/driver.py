"""Thread that drives the arms: it executes the browsers' commands and streams the targets.

Commands are queued by `ask`; the thread executes each one or refuses it with a notice. If the browser that controls
the arms is lost, the arms hold. When the page closes, the arms land.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import viser

from lerobot_robot_yam.errors import LifeCycleError, YamError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.session.base_client import BaseClient
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.viewer.moving.control_desk import ControlDesk, Stage
from lerobot_robot_yam.viewer.moving.driven_arms import DrivenArm, HeldBack, Replay
from lerobot_robot_yam.viewer.moving.driving_plan import DrivingPlan
from lerobot_robot_yam.viewer.moving.heartbeat import Heartbeat, Order, Orders, too_old
from lerobot_robot_yam.viewer.moving.notices import Notices

logger = logging.getLogger(__name__)

_PERIOD_S = 0.02


class Driver:
    """Driver of a plan's arms.

    Args:
        plan: plan with the configs of the arms and of the base.
        server: viser's server.
        isolation: see `ArmSession`.

    Attributes:
        desk: stage of the page, and browser in control. Other threads may only read it.
        arms: name → connected arm.
        replayed: recorded motion that all arms follow, or None.
        notices: notices to show. The reader removes them.
        held_back: arm name → pairs of parts that the arm's motion would bring too close together.
        heartbeat: heartbeat of the browsers.

    Raises:
        ConfigError: the arms cannot be used together.
    """

    def __init__(self, plan: DrivingPlan, server: viser.ViserServer, isolation: Isolation = "process"):
        self.plan = plan
        self.session = ArmSession(plan.parts, isolation)
        self.desk = ControlDesk()
        self.arms: dict[str, DrivenArm] = {}
        self.replayed: Replay | None = None
        self.notices = Notices()
        self.say = self.notices.say
        self.held_back: dict[str, str] = {}
        self._guard = HeldBack([self.session.hardware(config.name) for config in plan.configs])
        self._orders = Orders()
        self.heartbeat = Heartbeat(server, lambda: self.desk.holder)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="yam-view-driver", daemon=True)

    def start(self) -> None:
        """Start the thread. Nothing is energised."""
        self._thread.start()

    def ask(self, browser: int, work: Callable[[], object]) -> None:
        """Queue a command that requires control, or refuse it with a notice. Call this in the order of arrival."""
        try:
            self.desk.check(browser)
        except LifeCycleError as error:
            self.say(browser, str(error))
        else:
            self._queue(Order(browser, work, True, self.heartbeat.given_s(browser)))

    def ask_to_connect(self, browser: int) -> None:
        """Queue connecting the arms, which a person has confirmed after `Heartbeat.begin_question`."""
        self._queue(Order(browser, self.connect, False, self.heartbeat.given_s(browser)))

    def ask_freely(self, browser: int, work: Callable[[], object]) -> None:
        """Queue work that needs no control and energises nothing, with the current time. Any thread may call this."""
        self._queue(Order(browser, work, False, time.monotonic()))

    def ask_to_leave(self, browser: int) -> None:
        """Queue the removal of a disconnected browser. This command never expires."""
        self._orders.add(Order(browser, lambda: self.leave(browser), False, math.inf), always=True)

    def _queue(self, order: Order) -> None:
        if not self._orders.add(order):
            self.say(order.browser, "nothing was done: too many of your commands wait; give it again")

    # requests

    def connect(self) -> None:
        """Energise the arms, which then hold. A person must have confirmed. Raises YamError: an arm cannot start."""
        self.desk.begin()
        self.notices.forget()
        try:
            self.session.start()
            self.arms = {config.name: DrivenArm(self.session[config.name]) for config in self.plan.configs}
        except BaseException:
            self.session.stop()
            self.desk.end()
            raise
        self.desk.enable()
        self.say(None, "the arms hold where they are; `take control` to move them")

    def take(self, browser: int) -> None:
        """Give control to a browser, or request it from the holder. Raises LifeCycleError: no arms are connected."""
        if self.desk.take(browser):
            self._hand_to(browser)
        else:
            self.say(self.desk.holder, f"browser {browser} asks for control: `give control` hands it over")
            self.say(browser, f"browser {self.desk.holder} has been asked for control")

    def give(self, browser: int) -> None:
        """Pass a browser's control to the browser that has requested it, or to no browser. The arms hold.

        Raises:
            LifeCycleError: the browser does not have control.
        """
        holder = self.desk.give(browser)
        self._freeze()
        if holder is not None:
            self._hand_to(holder)

    def _hand_to(self, browser: int) -> None:
        self.heartbeat.begin(browser)
        self.say(None, f"browser {browser} controls the arms")

    def leave(self, browser: int) -> None:
        """Remove a disconnected browser. If that browser controlled the arms, they hold."""
        if self.desk.lost(browser):
            self._freeze()
            self.say(None, f"browser {browser}, which controlled the arms, is lost: they hold")

    def hold(self) -> None:
        """Hold each arm at its set-point; a floating arm holds its current pose."""
        self._stay()
        self._each(lambda client: client.hold())

    def let_float(self) -> None:
        """Let all arms float, so that a person can move them by hand. A base brakes."""
        self._stay()
        self._each(lambda client: client.hold() if isinstance(client, BaseClient) else client.float())

    def rearm(self) -> None:
        """Enable faulted arms again. Raises YamError: an arm is still in fault."""
        self._stay()
        self.session.rearm()

    def land(self) -> None:
        """Start landing all arms; a base brakes, and loses torque after them. Raises YamError: one cannot start."""
        self._stay()
        self._each(lambda client: client.land())

    @property
    def _clients(self) -> list[ArmClient | BaseClient]:
        return [*(arm.client for arm in self.arms.values()), *self.session.bases]

    def _each(self, work: Callable[[ArmClient | BaseClient], None]) -> None:
        """Call `work` for arms and base, even if it fails for one. Raises YamError: the first error of `work`."""
        failures: list[YamError] = []
        for client in self._clients:
            try:
                work(client)
            except YamError as error:
                failures.append(error)
        if failures:
            raise failures[0]

    def move(self, name: str, motor: int, value: float) -> None:
        """Move one joint or the gripper of an arm, see `DrivenArm.move`. Ends a replay."""
        self._end_replay()
        self._arm(name).move(motor, value, self.session.clock.now())

    def drag(self, browser: int, name: str, pose: np.ndarray) -> None:
        """Move the tool of an arm, see `DrivenArm.drag`. Ends a replay."""
        self._end_replay()
        said = self._arm(name).drag(pose, self.session.clock.now())
        if said:
            self.say(browser, said)

    def glide(self, goals: Mapping[str, np.ndarray]) -> None:
        """Move arms smoothly to poses. `goals`: arm name → pose (n,).

        Raises:
            YamError: an arm is not connected, in fault or silent. Nothing moves.
        """
        arms = [(self._arm(name), goal) for name, goal in goals.items()]
        self._stay()
        for arm, _ in arms:
            arm.client.observe()
        for arm, goal in arms:
            arm.glide(goal)

    def replay(self, trajectory: Trajectory) -> None:
        """Move all arms smoothly to a trajectory's first pose, then along it. `trajectory` has one column per motor.

        Raises:
            ActionError: the trajectory does not match these arms. Nothing moves.
            YamError: an arm is in fault or silent.
        """
        self._stay()
        self.replayed = Replay([arm.client for arm in self.arms.values()], trajectory, self.session.clock.now())

    def pause(self, paused: bool) -> None:
        """Pause the replay, or resume it."""
        if self.replayed is not None:
            self.replayed.paused = paused

    def change_gains(self, name: str, kp: np.ndarray, kd: np.ndarray) -> None:
        """Set the gains of an arm, each (joints,). Raises YamError: a config with these gains would also be refused."""
        self._arm(name).client.change_gains(kp, kd)

    def _arm(self, name: str) -> DrivenArm:
        if name not in self.arms:
            raise LifeCycleError(f"{name}: not connected")
        return self.arms[name]

    # the thread

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                self.round()
            except Exception:  # a defect in our code: targets cease, the arms hold, the page keeps running
                logger.exception("the driver's round failed")
                self._stay()
            self.session.clock.sleep(_PERIOD_S)

    def round(self) -> None:
        """Check for a lost browser, execute queued commands, and send targets."""
        if self.heartbeat.lost() and self.desk.holder is not None:
            self.leave(self.desk.holder)
        for order in self._orders.of_a_round():
            self._carry_out(order)
        if self.desk.stage in (Stage.ENABLED, Stage.CONTROL):
            self._drive()

    def _carry_out(self, order: Order) -> None:
        try:
            if order.controls:
                self.desk.check(order.browser)
            if too_old(order.given_s):
                raise LifeCycleError("nothing was done: the command is old, the page or its line slow; give it again")
            order.work()
        except YamError as error:
            self.say(order.browser, str(error))
        except Exception:  # a defect in our code, or a message that our page does not send
            logger.exception("a command of browser %d failed", order.browser)
            self.say(order.browser, "the command failed: see the terminal of yam-view")

    def _drive(self) -> None:
        if all(client.off for client in self._clients):
            self._finish()
            return
        now = self.session.clock.now()
        if self.replayed is not None:
            self._follow(self.replayed, now)
        for name, arm in self.arms.items():
            try:
                self._note_held_back(name)
                if not arm.step(now):
                    why = self.held_back.get(name) or "something is in its way"
                    self.say(None, f"{name}: held back, and holds now: {why}")
            except YamError as error:
                arm.stay()
                self.say(None, str(error))

    def _follow(self, replayed: Replay, now: float) -> None:
        try:
            if not replayed.step(now):
                return
            late = replayed.late()
            said = f"replayed; the arms hold{f', but {late} has not got there' if late else ''}"
        except YamError as error:
            said = str(error)
        self._end_replay()
        self.say(None, said)

    def _note_held_back(self, name: str) -> None:
        """Add a notice with the parts too close together when the collision guard starts to hold this arm back."""
        states = [arm.client.published() for arm in self.arms.values()]
        index = list(self.arms).index(name)
        if Limited.WORKSPACE not in states[index].limited:
            self.held_back.pop(name, None)
        elif name not in self.held_back:
            setpoints = [np.array(state.setpoints) for state in states]
            goals = [np.array(state.action or state.setpoints) for state in states]
            openings = [1.0 if state.gripper is None else state.gripper for state in states]
            if why := self._guard.reason(index, setpoints, goals, openings):
                self.held_back[name] = why
                self.say(None, f"{name}: held back: {why}")

    def _finish(self) -> None:
        """End the session after all arms have landed."""
        self._stay()
        self.session.stop()
        self.arms = {}
        self.desk.end()
        self.say(None, "the arms have landed; torque is off")

    def _end_replay(self) -> None:
        """End a replay if there is one; the arms hold, and a base goes on, whose rail may be homing."""
        if self.replayed is not None:
            self._freeze([arm.client for arm in self.arms.values()])

    def _stay(self) -> None:
        """End all motions and the replay. No further targets are sent."""
        self.replayed = None
        for arm in self.arms.values():
            arm.stay()

    def _freeze(self, clients: Sequence[ArmClient | BaseClient] | None = None) -> None:
        """Make tracking or floating arms hold, and a base, whose rail may be homing; None: all. Landing goes on."""
        self._stay()
        for client in self._clients if clients is None else clients:
            busy = (Mode.TRACK, Mode.HOLD) if isinstance(client, BaseClient) else (Mode.TRACK, Mode.FLOAT)
            try:
                if client.mode() in busy:
                    client.hold()
            except YamError as error:
                self.say(None, str(error))

    def close(self) -> None:
        """Land the arms and wait until they are down. Idempotent."""
        self._ended.set()
        self.session.begin_stop()  # otherwise `join` would wait for an arm that is still starting up
        self.heartbeat.close()
        if self._thread.ident is not None:
            self._thread.join()
        self.session.stop()
