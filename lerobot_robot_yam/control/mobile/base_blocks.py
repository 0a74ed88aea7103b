"""The control loop's end of a base's shared blocks: publish state, read targets and requests."""

import logging
import os
import struct

import numpy as np

from lerobot_robot_yam.control.mobile.base_controller import BaseController
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.mobile.base_target import Frame, Target
from lerobot_robot_yam.mobile.rail_profile import RailTarget
from lerobot_robot_yam.state.about import forget_about, tell_about
from lerobot_robot_yam.state.base_records import BASE_STATE_DTYPE, BaseRequest
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import BlockPair, state_path

logger = logging.getLogger(__name__)

_OWNER = BASE_STATE_DTYPE.fields["owner_pid"][1], struct.Struct("<Q")  # type: ignore[index]


class BaseBlocks:
    """Connection of a base's controller with its two blocks; others can watch its states.

    Args:
        controller: the base.
        key: name by which others find the base's states.
        pair: the base's blocks of states and commands.
        adopt: the last state of a loop that has died; its block stays in use.
    """

    def __init__(self, controller: BaseController, key: str, pair: BlockPair, adopt: np.ndarray | None = None):
        self._controller, self._key = controller, key
        self._states, self._commands = pair
        try:
            self._states.publish(state_path(key))
        except (OSError, YamError) as error:
            logger.warning("%s: no other program can watch the base: %s", controller.name, error)
        tell_about(key, controller.config)
        self._record = np.zeros((), BASE_STATE_DTYPE)
        if adopt is not None:
            self._record[()] = adopt
            self._states.adopt()
        self._owner = self._record["owner_pid"] = os.getpid()
        self._record["motors"] = controller.hardware.n
        self._first_tick = int(self._record["tick"])
        self._asked = self._answered = int(self._record["request_sequence"])
        self._seen = 0
        self._ended = False
        self.published_mode = Mode.OFFLINE

    @property
    def owned(self) -> bool:
        """False once another loop has taken the base over."""
        return bool(self._states.peek(*_OWNER) == self._owner)

    def read_target(self, now: float) -> None:
        """Give the controller what the caller has written since the last tick."""
        sequence, status = self._commands.sequence(), self._controller.status
        if sequence == self._seen or status.busy:
            return
        command = self._commands.glance()
        if command is None:
            return
        self._seen = sequence
        if command["request_sequence"] > self._asked:
            self._asked, status.refusal = int(command["request_sequence"]), ""
            try:
                self._controller.request(BaseRequest(int(command["request"])), now)
            except YamError as error:
                status.refusal = str(error)
        if command["target_sequence"] > self._record["target_sequence"]:
            self._record["target_sequence"] = command["target_sequence"]
            target = Target(command["values"].copy(), Frame(int(command["frame"])), bool(command["pose"]))
            self._controller.set_target(target, now, float(now - command["target_stamp_s"]))
        if command["rail_sequence"] > self._record["rail_sequence"]:
            self._record["rail_sequence"] = command["rail_sequence"]
            height = RailTarget(float(command["rail_value"]), bool(command["rail_height"]))
            self._controller.set_target(height, now, float(now - command["rail_stamp_s"]))

    def publish(self, now: float, tick: int) -> None:
        """Write the state of this tick. The state of a base that is off is written once."""
        if self._ended:
            return
        record, controller = self._record, self._controller
        status, chain, motion, n = controller.status, controller.chain, controller.motion, controller.hardware.n
        self._ended = status.mode is Mode.OFF
        self.published_mode = status.mode
        record["stamp_s"], record["tick"], record["asked_s"] = now, self._first_tick + tick, chain.asked_s.min()
        record["mode"], record["limited"] = status.mode, status.limited
        odometry = motion.odometry
        record["pose"], record["twist"], record["body_twist"] = odometry.pose, odometry.twist, odometry.body_twist
        record["planned"], record["slowed"] = motion.velocity, motion.slowed
        if controller.rail is not None:
            controller.rail.describe(record)
        motors = controller.motors
        record["q"][:n], record["dq"][:n], record["tau"][:n] = motors.q, motors.dq, motors.tau
        record["motor_stamp_s"][:n], record["fault"][:n], record["lost"][:n] = chain.stamp_s, chain.fault, chain.lost
        record["temp_mos_c"][:n], record["temp_rotor_c"][:n] = chain.temp_mos_c, chain.temp_rotor_c
        if self._answered != self._asked and not status.busy:
            self._answered = record["request_sequence"] = self._asked
            record["request_refused"], record["refusal"] = bool(status.refusal), status.refusal.encode()[:400]
        record["trouble"], record["message"] = (status.trouble or "").encode(), status.message.encode()[:400]
        self._states.write(record)

    def close(self, remove: bool) -> None:
        """Close both blocks; `remove` hides the states, unless a stand-by goes on with them."""
        self._states.close(remove)
        if remove:
            forget_about(self._key)
        self._commands.close()
