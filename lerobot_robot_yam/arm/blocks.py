"""The control loop's end of an arm's shared blocks: publish state, take targets and requests."""

import numpy as np

from lerobot_robot_yam.arm.controller import ArmController
from lerobot_robot_yam.arm.lifecycle import Mode
from lerobot_robot_yam.arm.state import COMMAND_DTYPE, STATE_DTYPE, Request, command_path, state_path
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.shared_block import SharedBlock


class ControllerBlocks:
    """Connects one controller with its two blocks. The caller has created the command block before.

    Args:
        controller: the arm.
        key: name of the channel's blocks.
    """

    def __init__(self, controller: ArmController, key: str):
        self._controller = controller
        self._commands = SharedBlock(command_path(key), COMMAND_DTYPE, create=False)
        self._states = SharedBlock(state_path(key), STATE_DTYPE, create=True)
        self._record = np.zeros((), STATE_DTYPE)
        for field in ("q", "dq", "tau", "setpoint", "motor_stamp_s", "temp_mos_c", "temp_rotor_c"):
            self._record[field] = np.nan
        self._seen = 0
        self._ended = False
        self._slots = controller.hardware.slots

    def take(self, now: float) -> None:
        """Give the controller what the caller has written since the last tick."""
        sequence = self._commands.sequence()
        if sequence == self._seen or sequence % 2:
            return
        command = self._commands.read()
        if command is None:
            return
        self._seen = sequence
        record, controller = self._record, self._controller
        if command["request_sequence"] != record["request_sequence"]:
            record["request_sequence"] = command["request_sequence"]
            try:
                controller.request(Request(int(command["request"])), now)
                record["request_refused"] = 0
            except YamError as error:
                record["request_refused"] = 1
                controller.message = str(error)
        if command["target_sequence"] != record["target_sequence"]:
            record["target_sequence"] = command["target_sequence"]
            slots = self._slots
            dq = command["dq"][slots]
            velocity = None if np.isnan(dq).any() else dq
            if now - command["target_stamp_s"] <= controller.config.command_timeout_s:
                controller.aim(command["q"][slots], now, velocity, command["kp"][slots], command["kd"][slots])

    def publish(self, now: float, tick: int) -> None:
        """Write the arm's state as of this tick; that of an arm which is off is written once, then it stands."""
        if self._ended:
            return
        c, record, slots = self._controller, self._record, self._slots
        chain = c.chain
        record["stamp_s"] = now
        record["tick"] = tick
        record["mode"] = c.mode
        record["limited"] = c.limited
        record["q"][slots] = c.q
        record["dq"][slots] = c.dq
        record["tau"][slots] = c.tau
        record["setpoint"][slots] = c.setpoint.q
        record["motor_stamp_s"][slots] = chain.stamp_s
        record["temp_mos_c"][slots] = chain.temp_mos_c
        record["temp_rotor_c"][slots] = chain.temp_rotor_c
        record["fault"][slots] = chain.fault
        record["lost"][slots] = chain.lost
        self._ended = c.mode is Mode.OFF
        if not self._ended:  # the handle of an arm that is off is not asked any more
            record["trigger"], record["buttons"], record["handle_stamp_s"] = c.handle.read(now)
        record["message"] = c.message.encode()[:240]
        self._states.write(record)

    def close(self) -> None:
        """Remove the state block, and the command block in case its caller has died."""
        self._states.close()
        self._commands.close(remove=True)
