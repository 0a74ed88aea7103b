"""Records of an arm as the soak's checks read them."""

import numpy as np

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE

CHANNEL, PEER = "follower_left", "follower_right"
LIMITS = np.array([1.5] * 6 + [2.5])
TICK_S = 0.004


def record(tick, setpoint, mode=Mode.TRACK, q=None, trouble="", pid=1):
    row = np.zeros((), STATE_DTYPE)
    row["tick"], row["stamp_s"], row["mode"], row["owner_pid"] = tick, 100.0 + tick * TICK_S, mode, pid
    slots = slice(len(setpoint))
    row["setpoint"][slots] = setpoint
    row["q"][slots] = setpoint if q is None else q
    row["fault"][slots] = Fault.NORMAL
    row["trouble"] = trouble.encode()
    return row
