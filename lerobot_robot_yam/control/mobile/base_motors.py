"""The motors of a base in joint coordinates: checks before the start, enabling, commands out, state in."""

import logging
from collections.abc import Generator, Sequence

import can
import numpy as np

from lerobot_robot_yam.control.joints.enabling import enable
from lerobot_robot_yam.control.preflight.arm_inspection import refuse_stopped
from lerobot_robot_yam.control.preflight.role import carries_base
from lerobot_robot_yam.control.safety.channel_monitor import BusLoss, ChannelMonitor
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_inspection import LISTEN_S, check_bandwidth, listen, verify
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ChannelInUseError, MotorError
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)

CASTER_MOTORS = slice(0, 8)  # steering and drive of each caster in turn
STEER = slice(0, 8, 2)
RAIL = 8
_DQ = 1  # column of the velocity in the commands of a chain
_READY_TICKS = 20  # ticks within which every motor must report that it is enabled: a reply may get lost
_OFF_S = 0.05  # wait for motors to report that they are off, s; the adapter's delay is added
_ROLLS_RAD_S = 2.0  # rate of a caster's motor from which a base rolls: 0.1 m/s; enabled, it would stop within 20 mm
_REFRESHES, _REFRESH_S = 3, 0.01  # attempts to read all motors at a take-over, and timeout of each, s


class BaseMotors:
    """Motors of one base.

    Args:
        hardware: the base.
        bus: an open bus; the caller closes it.

    Attributes:
        q, dq, tau: (n,) measured state, rad, rad/s, Nm.
        asked: (n,) commanded velocities, rad/s.
        instead: index of a motor -> special command that is sent once in place of its command.
    """

    def __init__(self, hardware: ResolvedBase, bus: can.BusABC):
        self._hardware, self._config, self._bus, n = hardware, hardware.config, bus, hardware.n
        self.chain = MotorChain(bus, hardware.motors, channel=self._config.channel, period_s=1.0 / self._config.rate_hz)
        self.watch, self.loss = ChannelMonitor(self.chain), BusLoss()
        self.q, self.dq, self.tau, self.asked = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.instead: dict[int, SpecialCommand] = {}
        self._commands = np.zeros((n, 5))

    def inspect(self) -> None:
        """Check that everything is there and as configured. Sends no command that moves or energises anything.

        Raises:
            YamError: a part is missing or differs; the message names it.
        """
        config, chain = self._config, self.chain
        refuse_stopped(config.name, EmergencyStop())
        check_bandwidth(len(chain), False, config.rate_hz)
        if not config.skip_listen:
            listen(self._bus, LISTEN_S, [motor.can_id for motor in chain.motors], config.channel)
        try:
            verify(chain)
        except MotorError as error:
            if carries_base(self._bus, config.channel) is not False:
                raise
            what = f"{config.name}: channel {config.channel} carries an arm: are cables or channels swapped?"
            raise MotorError(what) from error
        chain.refresh()
        self.read()
        if (np.abs(self.dq[CASTER_MOTORS]) > _ROLLS_RAD_S).any():
            where = f"{config.name} ({config.channel})"
            raise MotorError(f"{where}: it rolls, and would be stopped with a jerk; hold it still, then start again")

    def check_alone(self) -> None:
        """Raise ChannelInUseError if another driver has commanded these motors since `inspect`."""
        self.chain.drain()
        if self.chain.foreign_commands:
            where = f"{self._config.name} ({self._config.channel})"
            raise ChannelInUseError(f"{where}: another driver commands the motors; stop it and try again")

    def enable(self, motors: Sequence[int]) -> Generator[None, None, None]:
        """Clear faults of these motors and enable them, one step per tick.

        Raises:
            MotorError: a motor does not enable; the message names it.
        """
        self.chain.feedback.believe(motors)  # readings that were rejected before say nothing about the next ones
        silent = yield from enable(self, motors, clear=True)
        why = f"{self.names(silent)}: no answer; check power and cable"
        for _ in range(0 if silent else _READY_TICKS):
            yield
            finding = self.watch.check(self.chain.clock.now())
            if not finding.bad.any() and finding.trouble is None:
                return
            why = f"{finding.message}; look at the motor, or switch the base off and on"
        raise MotorError(f"{self._config.name} ({self._config.channel}): cannot enable {why}")

    def adopt(self, record: np.ndarray) -> None:
        """Take over from a loop that has died: `record` is the last state that it published.

        Raises:
            BusError: the channel does not take the frames; `q` is as published.
        """
        n = self._hardware.n
        positions = np.nan_to_num(record["q"][:n]) * self._hardware.sign
        self.chain.feedback.assume(positions, np.zeros(n), record["motor_stamp_s"][:n])
        self.read()  # else the rail would be held where its angle is 0
        for _ in range(_REFRESHES):
            if all(self.chain.refresh(timeout_s=_REFRESH_S)):
                break
        self.read()

    def read(self) -> None:
        """Update the state from the newest replies."""
        sign, chain = self._hardware.sign, self.chain
        self.q, self.dq, self.tau = chain.position_rad * sign, chain.velocity_rad_s * sign, chain.torque_nm * sign

    def send(self) -> None:
        """Put this tick's commands on the wire. Raises BusError: the channel does not take the frames."""
        self._commands[:, _DQ] = self.asked * self._hardware.sign
        instead, self.instead = self.instead, {}
        self.chain.send(self._commands, instead)
        self.loss.clear()

    def receive(self, until_s: float) -> None:
        """Process the replies to this tick's commands. Raises BusError: the channel is gone."""
        self.chain.collect(until_s)
        self.read()

    def complaints(self) -> list[str]:
        """Return warnings about adapter and cable."""
        delays = self.chain.round_trip
        return [f"{self._config.name} ({self.chain.channel}): {delays.summary()}"] if delays.slow else []

    def switch_off(self) -> Generator[None, None, None]:
        """Cut the torque of all motors, one step per tick; give up on motors that do not answer."""
        until_s = self.chain.clock.now() + _OFF_S + 2.0 * self.chain.round_trip.one_way_s
        on: list[int] = list(range(self._hardware.n))
        while on and self.chain.clock.now() < until_s:
            self.chain.feedback.believe(on)  # a motor whose readings were rejected also has to report that it is off
            self.instead = dict.fromkeys(on, SpecialCommand.DISABLE)
            yield
            on = np.flatnonzero(self.chain.fault == Fault.NORMAL).tolist()
        if on:
            logger.error(
                "%s: %s did not report off; their watchdogs switch them off", self._config.name, self.names(on)
            )

    def names(self, motors: Sequence[int]) -> str:
        """Name motors, for messages."""
        return ", ".join(f"{self.chain.motors[i].name} (id {self.chain.motors[i].can_id})" for i in motors)
