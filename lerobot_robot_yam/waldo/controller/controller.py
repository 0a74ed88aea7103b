"""Controller of one arm: moves a plant, accepts or refuses commands, and stops.

Everything except planning runs in one event loop. Only `arm` energises the arm, and clients cannot request `arm`.
"""

import asyncio
import logging
import random
import time
from collections.abc import Callable, Sequence

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ControllerError, YamError
from lerobot_robot_yam.waldo.arm_choice import NO_TOOL, tip
from lerobot_robot_yam.waldo.controller.motion import Motion
from lerobot_robot_yam.waldo.controller.plant import Plant, Reading, RealArm, SimulatedArm
from lerobot_robot_yam.waldo.planning.planner import Planner
from lerobot_robot_yam.waldo.poses import numbers
from lerobot_robot_yam.waldo.program import swapped

TICK_S = 0.01
_REST_S = 0.2  # time without motion after which the arm is made to hold, s; its own loop would wait 0.5 s
_NOT_HERE = "start the controller with --hardware at the arm's computer, and arm it there: yam-waldo arm"

logger = logging.getLogger(__name__)


class Controller:
    """Controller of one simulated or real arm. It starts in simulator mode.

    Args:
        hardware: profiles and limits of the arm.
        real: the real arm, or None if there is only the simulated arm.
        now: function that returns the time, s.

    Attributes:
        planner: planner for use in the event loop's thread.
        motion: the arm's set-point, and the commands that move it.
        plant: arm that follows the set-point.
        reading: state of the plant at the latest tick.
        tool_key, offset_m: selected tool, and the offset (3,) of its tip, m.
        stopped: whether an e-stop is latched.
        fault: reason of the plant's fault; empty if there is none.
        session_id: random number in every status. It tells clients that the controller was restarted.
    """

    def __init__(self, hardware: ResolvedArm, real: RealArm | None = None, now: Callable[[], float] = time.monotonic):
        self.hardware, self.real, self.now = hardware, real, now
        self.planner = Planner(hardware)
        self.simulated = SimulatedArm(hardware, self.planner.home_q)
        self.plant: Plant = self.simulated
        self.reading: Reading = self.plant.read()
        self.motion = Motion(self.planner, self.reading)
        self.tool_key, self.offset_m = NO_TOOL, np.zeros(3)
        self.use_tool(NO_TOOL, np.zeros(3))
        self.stopped, self.fault = False, ""
        self.session_id = random.randrange(1, 1 << 31)
        self._rest_at_s = np.inf
        self._arming = asyncio.Lock()

    @property
    def in_simulator(self) -> bool:
        """Whether commands move the simulated arm."""
        return self.plant is self.simulated

    @property
    def floats(self) -> bool:
        """Whether the real arm floats, instead of following commands."""
        return not self.in_simulator and not self.fault and self.real is not None and self.real.floats

    @property
    def ready_hardware(self) -> bool:
        """Whether there is a real arm that is armed and has no fault."""
        return self.real is not None and self.real.armed and not self.real.trouble()

    @property
    def refusal(self) -> str:
        """Reason why motion commands are refused; empty if they are accepted."""
        if self.fault:
            return f"the arm has failed, and holds as far as it can: {self.fault}"
        if self.stopped:
            return "an e-stop is latched: the arm holds and takes no commands until reset (resume)"
        return "the arm floats, so that a hand can move it: freedrive(False) ends that" if self.floats else ""

    def check_enabled(self) -> None:
        """Raise ControllerError if motion commands are refused."""
        if self.refusal:
            raise ControllerError(self.refusal)

    def tick(self) -> None:
        """Advance the set-point and send it to the plant. On an error, cancel all commands and record the fault."""
        now = self.now()
        try:
            self.reading = self.plant.read()
            if self.fault:
                return
            if self.floats:
                self._float_on()
                return
            moves = self.motion.step(now, self.reading)
            if moves:
                self.plant.follow(self.motion.q, self.motion.dq, self.motion.opening, TICK_S)
                self._rest_at_s = now + _REST_S
            elif now >= self._rest_at_s:
                self._rest_at_s = np.inf
                self.plant.rest()
            elif self.plant is self.real and (why := self.real.trouble()):
                raise ControllerError(why)
        except YamError as error:
            self.fail(str(error))

    def _float_on(self) -> None:
        """When the arm stops floating, continue from its pose. Raises ControllerError: the arm is in fault."""
        assert self.real is not None
        if why := self.real.trouble():
            raise ControllerError(why)
        if not self.real.floats:
            self.motion.take_over(self.reading)

    def fail(self, why: str) -> None:
        """Cancel all commands and record the fault. The arm's own control loop holds or lands the arm."""
        logger.error("%s", why)
        self.fault = why
        self.motion.take_over(self.reading)

    # clients' requests

    def stop(self) -> int:
        """Come to rest and empty the queue. Torque stays on. This is never refused."""
        if self.floats:
            try:
                self._hold_again()
            except YamError as error:
                self.fail(str(error))
        self.motion.stop(self.now())
        return 1

    def _hold_again(self) -> None:
        """Make a floating arm hold its pose, and continue from there."""
        self.plant.rest()
        self.reading = self.plant.read()
        self.motion.take_over(self.reading)

    def estop(self) -> int:
        """Stop, and refuse commands until `reset`."""
        self.stopped = True
        return self.stop()

    def reset(self) -> int:
        """Accept commands again. Nothing moves, and nothing is energised.

        Raises:
            ControllerError: the arm is still in fault.
        """
        if not self.in_simulator and self.real is not None and (why := self.real.trouble()):
            raise ControllerError(f"the arm takes no commands yet: {why}. To enable it again: yam-waldo arm")
        if self.fault:
            self.fault, self.reading = "", self.plant.read()
            self.motion.take_over(self.reading)
        self.stopped = False
        return 1

    def simulator(self, enabled: bool) -> int:
        """Select whether commands move the simulated arm or the real arm, which holds its pose. Drop all commands.

        Raises:
            ControllerError: there is no real arm that is armed and has no fault.
        """
        if enabled == self.in_simulator:
            return 1
        if enabled:
            self._leave_hardware()
            return 1
        if self.real is None:
            raise ControllerError(f"this controller has no hardware; {_NOT_HERE}")
        if why := self.real.trouble():
            raise ControllerError(f"the arm cannot be driven: {why}")
        self._use(self.real)
        return 1

    def _leave_hardware(self) -> None:
        last = self.reading
        try:
            self.plant.rest()
        except YamError as error:  # the arm is in fault: its own loop holds or lands it
            logger.warning("%s", error)
        self.simulated.teleport(np.clip(last.q, self.planner.lower, self.planner.upper), last.opening)
        self._use(self.simulated)

    def _use(self, plant: Plant) -> None:
        self.plant, self.fault, self._rest_at_s = plant, "", np.inf
        self.reading = plant.read()
        self.motion.take_over(self.reading)

    def freedrive(self, enabled: bool) -> int:
        """Let a person move the real arm by hand, or make the arm hold its pose.

        Raises:
            ControllerError: commands move the simulated arm, or motion commands are refused.
        """
        if self.in_simulator or self.real is None:
            raise ControllerError("freedrive is for the real arm; a simulated one is put somewhere by teleport")
        if enabled and not self.floats:
            self.check_enabled()
            self.motion.take_over(self.reading)
            self.real.let_float()
        elif not enabled and self.floats:
            self._hold_again()
        return 1

    def teleport(self, angles_deg: Sequence[float], tool_positions: Sequence[float] | None = None) -> int:
        """Set the simulated arm's joints (deg) and jaws (0 open … 1 closed) at once.

        Raises:
            ControllerError: commands move the real arm.
            PlanError: a value is malformed or beyond its limit.
        """
        if not self.in_simulator:
            raise ControllerError("teleport is for the simulator, and commands move the real arm now; nothing moves")
        q = self.planner.within(np.radians(numbers("angles", angles_deg, self.hardware.joints)))
        opening = None
        if tool_positions is not None and len(tool_positions):
            opening = swapped(float(np.clip(numbers("tool_positions", tool_positions, 1)[0], 0.0, 1.0)))
        self.simulated.teleport(q, opening)
        self._use(self.simulated)
        return 1

    def use_tool(self, key: str, offset_m: np.ndarray) -> None:
        """Select the tool whose tip poses refer to. Raises ConfigError: the arm has no tool with this key."""
        frame = tip(self.hardware.gripper, key, offset_m)
        self.tool_key, self.offset_m, self.tip = key, offset_m, frame
        self.planner.kinematics.tool = frame

    # requests reserved for the operator at this computer

    async def arm(self) -> None:
        """ENERGISE the real arm, which then holds its pose. Commands still move the same plant as before.

        Raises:
            YamError: there is no real arm, or arming failed and energised nothing.
        """
        async with self._arming:
            if self.real is None:
                raise ControllerError(f"this controller has no hardware; {_NOT_HERE}")
            await asyncio.to_thread(self.real.arm)

    async def land(self) -> bool:
        """Land the real arm and cut its torque. Commands move the simulated arm from now on.

        Returns:
            Whether the arm has landed. If not, its control loop holds the arm and lands as soon as possible.
        """
        async with self._arming:
            if not self.in_simulator:
                self._leave_hardware()
            return self.real is None or await asyncio.to_thread(self.real.land)
