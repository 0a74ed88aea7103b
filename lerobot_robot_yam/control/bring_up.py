"""Bring-up: energise a limp arm and find its gripper's stops, until the arm holds or floats."""

from collections.abc import Iterator

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.float_monitor import FloatMonitor
from lerobot_robot_yam.control.joints.enabling import enable
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.errors import ChannelInUseError, MotorError, YamError
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode

_ENABLE_TICKS = 20  # maximum number of ticks until a motor reports that it is enabled: replies may get lost


class BringUp:
    """Bring-up of one arm, ending in the mode `after`."""

    def __init__(self, actuation: Actuation, interface: JointInterface, floating: FloatMonitor):
        self._actuation, self._interface, self._floating = actuation, interface, floating
        self._status = actuation.status
        self.after = Mode.FLOAT if self._status.floats else Mode.HOLD

    def energise(self) -> Iterator[None]:
        """Enable the motors, one step per tick, and hold the measured pose from the first command on.

        Raises:
            ChannelInUseError: another driver commands these motors; no frame was sent.
            MotorError: a motor does not enable, or another driver appears; the caller must call `abandon`.
        """
        arm = self._actuation
        where = f"{arm.name} ({arm.config.channel})"
        self._status.check(Mode.BRING_UP)
        arm.chain.drain()
        if arm.chain.foreign_commands:  # another driver may hold the arm
            raise ChannelInUseError(
                f"{arm.name}: another driver commands the motors on {arm.config.channel}; stop it and try again"
            )
        self._status.enter(Mode.BRING_UP)
        arm.chain.feedback.believe(range(arm.hardware.n))  # a hand may have moved the arm
        arm.setpoint.start()
        silent = yield from enable(self._interface, range(arm.hardware.n))
        if silent:
            names = ", ".join(f"{motor.name} (id {motor.can_id})" for motor in (arm.chain.motors[i] for i in silent))
            raise MotorError(f"{where}: cannot enable {names}: no answer; check power and cable")
        for _ in range(_ENABLE_TICKS):
            arm.setpoint.seed(arm.q)
            arm.compute_command(0.0, 0.0)
            yield
            finding = arm.estimate.find_trouble(arm.chain.clock.now())
            if not finding.bad.any():
                break
        if finding.bad.any():
            raise MotorError(f"{where}: cannot enable {finding.message}; power-cycle the arm or look at its motors")
        if finding.trouble is not None:  # another driver on the channel
            raise MotorError(f"{where}: {finding.message}")

    def advance(self, now: float) -> tuple[Trouble, str] | None:
        """Advance by one tick; leave bring-up once the gripper's stops are known. Return a fault that prevents this."""
        arm = self._actuation
        if arm.gripper is not None and arm.gripper.searching:
            try:
                shift = arm.gripper.advance(now, float(arm.estimate.motor_q[-1]))
            except YamError as error:
                return Trouble.GRIPPER, str(error)
            if shift is None:
                return None
            self._interface.shift_gripper(shift)
            arm.setpoint.start_one(arm.hardware.n - 1)
        after = Mode.HOLD if self._status.halted else self.after
        if after is Mode.FLOAT:
            wrong = self._floating.settled()
            if wrong is None:
                return None
            if wrong:
                return Trouble.WEIGHT, f"{arm.name} does not float: {wrong}"
        arm.enter(after)
        return None
