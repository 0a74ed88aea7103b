"""States of a host as this computer has them: by its own clock, and never from the future."""

import contextlib
import time

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.remote.mirrored_part import MirroredPart
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, lock_path
from lerobot_robot_yam.system.runtime_files import FileLock
from lerobot_robot_yam.system.shared_block import SharedBlock

AHEAD_S = 1000.0
OLD_S = 0.01


def host_state(published_s):
    """A record of one motor whose sample was taken OLD_S before, by the host's clock."""
    record = np.zeros((), STATE_DTYPE)
    record["mode"], record["joints"], record["motors"] = Mode.HOLD, 1, 1
    record["stamp_s"] = published_s
    record["asked_s"], record["motor_stamp_s"][0] = published_s - OLD_S, published_s - OLD_S
    return record.tobytes()


@pytest.mark.parametrize("wrong_s", [0.0, 40.0])
def test_a_state_is_never_from_the_future(wrong_s):
    """Not even while the offset of the clocks is wrong, after a sleep of this computer."""
    block = SharedBlock(None, STATE_DTYPE, create=True)
    config, lock = ArmConfig(name="arm", channel="can0"), FileLock(lock_path("test-mirror"), "a test")
    with contextlib.closing(MirroredPart("test-mirror", config, lock, block, None, {})) as arm:
        begin = time.monotonic()
        arm.write(host_state(begin - 0.02 + AHEAD_S + wrong_s).rstrip(b"\0"), AHEAD_S)
        state, now = ArmState(block.read_bytes()), time.monotonic()
    expected_s = begin - 0.02 if wrong_s == 0.0 else begin
    assert expected_s - 1e-6 <= state.published_s <= now
    assert state.published_s - state.stamp_s == pytest.approx(OLD_S)
    assert state.published_s - state.asked_s == pytest.approx(OLD_S)
