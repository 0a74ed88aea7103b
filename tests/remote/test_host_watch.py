"""Watching a host stands in nobody's way: whoever drives an arm over a link finds its channel free."""

import time
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.remote.host_question import Host
from lerobot_robot_yam.remote.host_watch import watched, watched_key
from lerobot_robot_yam.state.records import STATE_DTYPE, lock_path, state_path
from lerobot_robot_yam.system.runtime_dirs import lock_holders
from lerobot_robot_yam.system.runtime_files import FileLock, runtime_dir
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.hosted import ServedArms
from tests.support.waiting import wait

ARMS = ("follower_left", "follower_right")


@pytest.fixture
def served():
    """A host that has energised nothing."""
    with ServedArms(SimpleNamespace(name="a-rig", live=True), *ARMS) as served:
        yield served


def wait_shown(keys):
    """Until these arms are shown, and no others."""

    def shown():
        return {key for key in lock_holders(runtime_dir()) if key.endswith(".watched")}

    wait(lambda: shown() == {*map(watched_key, keys)}, 10.0)


def test_an_arm_that_is_watched_can_be_driven_and_is_shown_again_afterwards(served):
    left, right = (served.address.key(channel) for channel in ARMS)
    with watched(Host(served.address)):
        wait_shown([left, right])
        with FileLock(lock_path(left), "as a link process"):
            block = SharedBlock(state_path(left), STATE_DTYPE, create=True)
            wait_shown([right])
            assert block.current
            block.close()
        wait_shown([left, right])
    wait_shown([])


def test_one_of_two_watchers_shows_the_arms(served):
    keys = [served.address.key(channel) for channel in ARMS]
    with watched(Host(served.address)):
        wait_shown(keys)
        with watched(Host(served.address)):
            time.sleep(0.3)
        wait_shown(keys)
