"""Loop for leaders without motors: reads encoders, advances gates, and publishes states like a control loop.

Nothing is energised and nothing lands. The published state of such a leader is FLOAT or STOPPED.
"""

import logging
import math
import os
from collections.abc import Callable, Sequence

import can
import numpy as np

from lerobot_robot_yam.arm.config import lead_of, passive_of
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.gripper.handle_reader import HandleReader
from lerobot_robot_yam.control.gripper.trigger_range import TriggerRange
from lerobot_robot_yam.control.teleop.lead import Lead, make_leads
from lerobot_robot_yam.control.teleop.passive_mapping import PassiveMapping
from lerobot_robot_yam.damiao.bus_port import BusPort
from lerobot_robot_yam.damiao.handle_encoder import HandleEncoder, HandleReport
from lerobot_robot_yam.damiao.passive_encoders import PassiveEncoders
from lerobot_robot_yam.errors import BusError, YamError
from lerobot_robot_yam.state.about import forget_about, tell_about
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, BlockPair, state_path

logger = logging.getLogger(__name__)

_UNKNOWN = ("temp_mos_c", "temp_rotor_c", "offset_rad", "gripper_stops_rad", "action", "action_dq", "action_stamp_s")
_SILENT_S = 0.1  # time without a report after which an encoder counts as silent: 20 reports
_AGAIN_S = 0.05  # pause after a channel error before the next read
_RELEASED, _SQUEEZED = 0.3, 0.7  # a trigger counts as released below the first value, as squeezed above the second


class PassiveArm:
    """Passive leader: an arm with encoders but without motors.

    Args:
        arm: the configured leader, with the follower's profile.
        bus: open bus of the leader's channel; the caller closes the bus.
        key: channel key under which the leader's states are published.
        pair: the leader's shared blocks.
        lead: the leader's teleoperation side; None without a follower.

    Raises:
        YamError: the leader's calibration is unusable.
    """

    def __init__(self, arm: ResolvedArm, bus: can.BusABC, key: str, pair: BlockPair, lead: Lead | None):
        config = passive_of(arm.config)
        assert config is not None
        self.name, self._joints, self._lead = arm.name, arm.joints, lead
        self.port = BusPort(bus, arm.config.channel)
        self._mapping = PassiveMapping(arm.name, config, arm.arm.joint_limits_rad)
        self._encoders = PassiveEncoders(arm.joints)
        self._states = pair.states
        self._record = record = np.zeros((), STATE_DTYPE)
        for field in _UNKNOWN:
            record[field] = np.nan
        record["joints"] = record["motors"] = arm.joints
        record["owner_pid"] = os.getpid()
        try:
            pair.states.publish(state_path(key))
        except (OSError, YamError) as error:
            logger.warning("%s: no other program can watch the arm: %s", arm.name, error)
        self._key = key
        tell_about(key, arm.config)
        self._lost = ""  # present error of the channel, or empty
        self._told: list[str] = []
        self._trigger = HandleEncoder()  # the last encoder, read as a teaching handle
        self._handle = HandleReader(arm.name, self._trigger, TriggerRange())

    def start(self) -> None:
        """Wait for all encoders. Raises YamError: encoders are silent; the message names these."""
        self._encoders.start(self.port, self.name)

    def read(self, until_s: float) -> None:
        """Process encoder reports until the time `until_s`. If the channel is lost, the state becomes stale."""
        try:
            self._encoders.collect(self.port, until_s)
            self._lost = ""
        except BusError as error:
            self._lost = f"its channel: {error}"
            self.port.clock.sleep(max(0.0, until_s - self.port.clock.now()) + _AGAIN_S)

    @property
    def trigger(self) -> float:
        """Trigger as published, 0 released … 1 squeezed; NaN while its encoder is silent."""
        return float(self._record["trigger"])

    def publish(self, now: float, mode: Mode) -> None:
        """Publish the leader's state at time `now`. mode: FLOAT or STOPPED."""
        record, encoders, joints = self._record, self._encoders, self._joints
        j = slice(joints)
        q, dq = self._mapping.joints(encoders.angle_rad[j], encoders.rate_rad_s[j])
        record["stamp_s"], record["mode"] = now, mode
        record["tick"] += 1
        record["q"][j], record["dq"][j], record["setpoint"][j] = q, dq, q
        record["motor_stamp_s"][j] = encoders.stamp_s[j]
        record["asked_s"] = encoders.stamp_s[j].min()
        angle, rate = float(encoders.angle_rad[joints]), float(encoders.rate_rad_s[joints])
        self._trigger.report = HandleReport(angle, rate, encoders.buttons, self._mapping.trigger(angle))
        self._trigger.stamp_s = float(encoders.stamp_s[joints])
        handle = self._handle.read(now)
        record["trigger"], record["buttons"], record["handle_stamp_s"], record["presses"] = handle
        self._tell([self._lost] if self._lost else encoders.silent(now - _SILENT_S))
        if self._lead is not None:
            self._lead.advance(now, mode, (q, dq, encoders.stamp_s[j].copy()), handle[:3], np.zeros(joints))
            self._lead.note(record)
        self._states.write(record)

    def _tell(self, silent: list[str]) -> None:
        if silent != self._told:
            if silent:
                logger.warning("%s: nothing is heard of %s", self.name, ", ".join(silent))
            elif self._told:
                logger.info("%s: all encoders are heard again", self.name)
            self._told = silent

    def end(self, now: float) -> None:
        """Publish mode OFF, then remove the leader's state block."""
        self._record["stamp_s"], self._record["mode"], self._record["gate"] = now, Mode.OFF, Gate.NONE
        self._states.write(self._record)
        if self._lead is not None:
            self._lead.close()
        self._states.close(remove=True)
        forget_about(self._key)


class PassiveStop:
    """Emergency stop for the leaders of a loop, which may fall when a person lets go to stop the arms. Check each tick.

    A leader that fell onto the table must not move its follower once the stop is released. Gates that begin with a lift
    or a button prevent such a motion. All other leaders stay stopped until their triggers are squeezed, a sign that a
    person holds the leader. A squeezed trigger also keeps an object in the follower's gripper.

    Args:
        stop: the emergency stop.
        names: leader index -> name, for leaders that stay stopped until their triggers are squeezed.
    """

    def __init__(self, stop: EmergencyStop, names: dict[int, str]):
        self._stop, self._names = stop, names
        self._stopped = self._told = False
        self._least: dict[int, float] = {}  # minimum of each trigger since the release

    def check(self, triggers: Sequence[float]) -> bool:
        """Return whether the leaders are stopped. triggers: 0 released … 1 squeezed, NaN while silent."""
        if self._stop.latched:
            self._stopped, self._told = True, False
            self._least = dict.fromkeys(self._names, math.inf)
        elif self._stopped:
            self._stopped = not self._confirmed(triggers)
        return self._stopped

    def _confirmed(self, triggers: Sequence[float]) -> bool:
        """Return whether each trigger has been released and then squeezed since the end of the stop."""
        if self._names and not self._told:
            which = " and ".join(self._names.values())
            logger.warning("%s: squeeze the trigger, with the leader in your hand, to go on after the stop", which)
            self._told = True
        for index, least in self._least.items():
            self._least[index] = min(least, triggers[index])  # NaN changes nothing
        if not all(least < _RELEASED and triggers[index] > _SQUEEZED for index, least in self._least.items()):
            return False
        logger.info("leaders go on after the emergency stop")
        return True


def run(
    arms: Sequence[ResolvedArm],
    buses: Sequence[can.BusABC],
    keys: Sequence[str],
    pairs: Sequence[BlockPair],
    on_ready: Callable[[str], None],
    must_end: Callable[[], bool],
) -> None:
    """Read and publish the leaders until `must_end` returns True.

    Args:
        on_ready: called once, with "", when all encoders of all leaders report.

    Raises:
        YamError: a leader is silent at the start, or a leader's calibration is unusable.
    """
    made: list[PassiveArm] = []
    try:
        for arm, bus, key, pair, lead in zip(arms, buses, keys, pairs, make_leads(arms), strict=True):
            made.append(PassiveArm(arm, bus, key, pair, lead))
        for leader in made:
            leader.start()
        clock, period_s = made[0].port.clock, 1.0 / arms[0].config.rate_hz
        stop = PassiveStop(EmergencyStop(), {i: arm.name for i, arm in enumerate(arms) if not _waits(arm)})
        mode = Mode.FLOAT
        for leader in made:
            leader.publish(clock.now(), mode)
        on_ready("")
        deadline = clock.now()
        while not must_end():
            deadline = max(deadline + period_s, clock.now())
            for leader in made:
                leader.read(deadline if leader is made[-1] else 0.0)
            mode = Mode.STOPPED if stop.check([leader.trigger for leader in made]) else Mode.FLOAT
            for leader in made:
                leader.publish(clock.now(), mode)
    finally:
        for leader in made:
            leader.end(leader.port.clock.now())


def _waits(arm: ResolvedArm) -> bool:
    """Return whether a gate waits for a person before the follower approaches this leader."""
    lead = lead_of(arm.config)
    return lead is not None and lead.gate != "always"
