"""One arm as the monitor sees it: latest state record, history and limits."""

import contextlib
from collections import deque
from typing import Any

import numpy as np

from lerobot_robot_yam.control.stop_response import PRESS_NM
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from soak.checks import GRIPPER, SetPointCheck, mode_of

_KEPT = 500  # number of latest records kept
_AROUND_S = 0.3  # span before and after a violation whose records are reported, s
_TOLD = ("stamp_s", "motor_stamp_s", "q", "dq", "tau", "setpoint", "action", "action_dq", "action_stamp_s")


def newest_record(key: str) -> Any:
    """Return the latest state record of the arm whose blocks have this key; None if there is none."""
    with contextlib.suppress(FileNotFoundError, YamError):
        block = SharedBlock(state_path(key), STATE_DTYPE, create=False)
        try:
            return block.read()
        finally:
            block.close()
    return None


class Arm:
    """State records and limits of one arm.

    Args:
        channel: CAN channel of the arm.
        job: role; key of the arm's blocks; speed_limit (7,) of the set-point; motor_speed_limit, torque_limit, kp and
            kd (n,) rad/s, Nm, Nm/rad and Nm s/rad at the motors, gripper last; rest_q (6,) rad; peer, channel of the
            robot's other arm; leads, channel of the follower that this arm leads at loop rate, or None; tick_s.
    """

    def __init__(self, channel: str, job: dict[str, Any]):
        self.channel, self.role, self.peer = channel, job["role"], job["peer"]
        self.leads: str | None = job.get("leads")
        self.motor_speed_limit = np.array(job["motor_speed_limit"])
        self.torque_limit = np.array(job["torque_limit"])
        self.kp, self.kd = np.array(job["kp"]), np.array(job["kd"])
        self.rest_q = np.array(job["rest_q"])
        press_rad = np.zeros(GRIPPER + 1)
        press_rad[:GRIPPER] = PRESS_NM / np.maximum(self.kp[:GRIPPER], 1.0)
        self.speed_limit = np.array(job["speed_limit"])[:GRIPPER]
        self.tick_s: float = job["tick_s"]
        self.check = SetPointCheck(
            channel, np.array(job["speed_limit"]), job["role"] == "leader", press_rad, self.tick_s
        )
        self.record: Any = None
        self.records = 0
        self._history: deque[Any] = deque(maxlen=_KEPT)
        self._path = state_path(job["key"])
        self._block: SharedBlock | None = None
        self._sequence = 0

    def read(self) -> Any:
        """Return the latest record; None if there is no new one."""
        if self._block is None or not self._block.current:
            self._open()
        block = self._block
        if block is None or block.sequence() == self._sequence:
            return None
        with contextlib.suppress(YamError):
            sequence, record = block.sequence(), block.read()
            if record is None:
                return None
            self._sequence, self.record = sequence, record
            self.records += 1
            self._history.append(record)
            return record
        return None

    def _open(self) -> None:
        self.close()
        self.record, self._sequence = None, 0
        self.check.forget()
        with contextlib.suppress(FileNotFoundError, YamError):
            self._block = SharedBlock(self._path, STATE_DTYPE, create=False)

    def history(self, at_s: float) -> list[dict[str, Any]]:
        """Return all kept states around the monotonic time `at_s`, for the analysis of a violation."""
        found = []
        for record in self._history:
            if abs(float(record["stamp_s"]) - at_s) < _AROUND_S:
                row = {name: record[name].round(4).tolist() for name in _TOLD}
                found.append(row | {name: int(record[name]) for name in ("mode", "limited", "tick", "coupled_to")})
        return found

    def reading_age_s(self, since_s: float, until_s: float) -> np.ndarray:
        """Return the maximum age (slots,) of each motor's reading in the loop, over the kept records of this span."""
        ages = [
            record["stamp_s"] - record["motor_stamp_s"]
            for record in self._history
            if since_s < float(record["stamp_s"]) < until_s
        ]
        return np.nan_to_num(np.max(ages, axis=0)) if ages else np.zeros(GRIPPER + 1)

    @property
    def driven(self) -> bool:
        """Whether the record says that a control loop drives the arm."""
        return self.record is not None and mode_of(self.record) not in (Mode.OFF, Mode.OFFLINE)

    def close(self) -> None:
        """Close the state block."""
        block, self._block = self._block, None
        if block is not None:
            block.close()
