"""Plants of the controller: simulated or real arms that follow the controller's set-point.

The real arm is driven through a session, so its limits, landing, emergency stop and stand-by apply. Only
`RealArm.arm` energises the arm. Only an operator's command calls `RealArm.arm`.
"""

import dataclasses
import logging
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ControllerError, LifeCycleError, YamError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession, Isolation
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode

_JAW_ROUNDING = 0.03  # maximum position error of free jaws, as a fraction of the stroke
_STILL_PER_S = 0.02  # speed below which the jaws count as still, strokes/s

logger = logging.getLogger(__name__)


class Reading(NamedTuple):
    """State of an arm with n joints at one time.

    Attributes:
        q, dq, tau_nm: (n,) measured angles, speeds and torques, rad, rad/s, Nm.
        setpoint_q: (n,) set-point of the arm's own control loop, rad.
        opening, asked_opening: measured and target gripper opening, 0 closed … 1 open; None without a gripper.
        jaw_still: whether the jaws are at rest, at their target or blocked.
        grip_nm: torque of the gripper's motor, Nm.
    """

    q: np.ndarray
    dq: np.ndarray
    tau_nm: np.ndarray
    setpoint_q: np.ndarray
    opening: float | None
    asked_opening: float | None
    jaw_still: bool
    grip_nm: float

    @property
    def holds_part(self) -> bool:
        """Whether an object keeps the jaws from closing."""
        if self.opening is None or self.asked_opening is None or not self.jaw_still:
            return False
        return self.opening - self.asked_opening > _JAW_ROUNDING


class Plant(Protocol):
    """Arm that follows a set-point."""

    def read(self) -> Reading:
        """Return the current state. Raises YamError: the arm has failed or is silent."""

    def follow(self, q: np.ndarray, dq: np.ndarray, opening: float | None, dt_s: float) -> None:
        """Set the set-point for this tick of dt_s: q (n,) rad, its speed dq (n,) rad/s, and the gripper's target.

        Raises:
            YamError: the arm does not accept targets.
        """

    def rest(self) -> None:
        """Hold the last set-point, since no further one follows for now. Raises YamError: the arm is in fault."""


class SimulatedArm:
    """Plant without motors that is always exactly at its set-point. Its jaws move at the gripper's speed limit.

    `q`: initial joints (n,), rad.
    """

    def __init__(self, hardware: ResolvedArm, q: np.ndarray):
        self._q, self._dq = np.array(q), np.zeros(len(q))
        self._jaw_speed = float(hardware.speed_limit[-1]) if hardware.has_gripper else 0.0
        self._opening = self._asked = 1.0 if hardware.has_gripper else None

    def read(self) -> Reading:
        still, zero = self._opening == self._asked, np.zeros(len(self._q))
        return Reading(self._q, self._dq, zero, self._q, self._opening, self._asked, still, 0.0)

    def follow(self, q: np.ndarray, dq: np.ndarray, opening: float | None, dt_s: float) -> None:
        self._q, self._dq = q, dq
        if self._opening is not None and opening is not None:
            most = self._jaw_speed * dt_s
            self._asked = opening
            self._opening += min(max(opening - self._opening, -most), most)

    def rest(self) -> None:
        self._dq = np.zeros(len(self._q))

    def teleport(self, q: np.ndarray, opening: float | None) -> None:
        """Set the joints q (n,), rad, and the jaw opening (unless None) at once."""
        self._q, self._dq = q, np.zeros(len(q))
        if self._opening is not None and opening is not None:
            self._opening = self._asked = opening


class RealArm:
    """Plant that drives the arm on a CAN channel. All methods except `arm` and `land` return immediately.

    The arm tracks with `track_integral`. Without it, friction moves a virtual arm's tool up to 2.7 mm off a line.

    Args:
        config: config of the arm.
        isolation: where the arm's control loop runs, see `ArmSession`.

    Attributes:
        config: config for the next arming.
        floats: whether the arm floats, and so does not accept targets.
    """

    def __init__(self, config: ArmConfig, isolation: Isolation = "process"):
        self.config, self._isolation = dataclasses.replace(config, track_integral=True), isolation
        self._session: ArmSession | None = None
        self.floats = False

    @property
    def armed(self) -> bool:
        """Whether an operator has armed the arm, and it has not landed since."""
        return self._session is not None and self._session.running

    @property
    def client(self) -> ArmClient:
        """Session client of the armed arm. Raises ControllerError: the arm is not armed."""
        if self._session is None or not self._session.running:
            raise ControllerError(f"{self.config.name}: it is not armed; at its computer: yam-waldo arm")
        return self._session[self.config.name]

    def load(self, mass_kg: float, com_m: Sequence[float]) -> None:
        """Set the payload at the tool. Raises YamError: a value is out of range, or the arm is armed."""
        if self.armed:
            raise ControllerError(
                f"{self.config.name}: the arm is armed, and carries what it was armed with; `yam-waldo land` first"
            )
        self.config = dataclasses.replace(self.config, payload_mass_kg=mass_kg, payload_com_m=list(com_m))

    def keep_clear(self, workspace: WorkspaceConfig) -> None:
        """Set the workspace. Raises YamError: the workspace is malformed, or the arm is armed."""
        if self.armed:
            raise ControllerError(f"{self.config.name}: the arm is armed; `yam-waldo land`, then change the shapes")
        self.config = dataclasses.replace(self.config, workspace=workspace)

    def arm(self) -> None:
        """ENERGISE the arm, which then holds its pose. Blocks. Does nothing if the arm is armed and has no fault.

        A faulted arm is first re-enabled in its pose. If that fails, it is landed as far as possible, and armed again.

        Raises:
            YamError: arming failed, and energised nothing in addition.
        """
        if self._session is not None:
            why = self.trouble()
            if not why:
                return
            if self.client.published().mode is Mode.STOPPED:
                raise LifeCycleError(why)
            try:
                self._session.rearm()
                return
            except LifeCycleError as error:
                logger.warning("%s; it is connected anew", error)
                self.land()
        session = ArmSession([self.config], self._isolation)
        session.start()
        self._session = session

    def land(self) -> bool:
        """Land the arm, cut its torque and release the channel. Return False if the arm has not landed. Idempotent."""
        session, self._session = self._session, None
        return session is None or session.stop()

    def trouble(self) -> str:
        """Return why the arm neither accepts targets nor floats as requested; empty if it does."""
        try:
            self._taking()
        except YamError as error:
            return str(error)
        return ""

    def _taking(self) -> ArmState:
        """Return the newest state. Raises YamError: the arm neither accepts targets nor floats as requested."""
        state = self.client.newest()
        if state.mode is Mode.STOPPED:
            raise LifeCycleError(f"{self.config.name}: the emergency stop is latched; `yam-estop release` ends it")
        self.floats = self.floats and state.mode is Mode.FLOAT
        if state.mode not in (Mode.HOLD, Mode.TRACK) and not self.floats:
            raise LifeCycleError(f"{self.config.name}: it takes no targets in mode {state.mode.name.lower()}")
        return state

    def read(self) -> Reading:
        state = self.client.published()
        still = state.gripper_rate is None or abs(state.gripper_rate) < _STILL_PER_S
        return Reading(
            state.q, state.dq, state.tau_nm, state.setpoint_q, state.gripper, self._asked(state), still,
            state.gripper_tau_nm or 0.0,
        )  # fmt: skip

    @staticmethod
    def _asked(state: ArmState) -> float | None:
        action = state.action
        return state.gripper_setpoint if action is None or state.gripper is None else action[-1]

    def follow(self, q: np.ndarray, dq: np.ndarray, opening: float | None, dt_s: float) -> None:
        self._taking()
        self.client.write_target(q, opening, dq)

    def rest(self) -> None:
        self._taking()
        self.client.hold()
        self.floats = False

    def let_float(self) -> None:
        """Let the arm float, with its weight compensated. Raises YamError: the arm cannot float."""
        self._taking()
        self.client.float()
        self.floats = True
