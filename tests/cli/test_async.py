"""LeRobot's policy server and robot client, in two processes, on the virtual rig; and what a lost server does."""

import os
import signal
import socket
import time

import numpy as np
import pytest
import yaml

from tests.policy_plugin.checkpoints import save_act
from tests.support.rolling import FOLLOWERS, FPS, Rollout, config

pytestmark = pytest.mark.alone

HOLD_S = 0.6
STILL_RAD_S = 0.02
PERIOD_S, AMPLITUDE_RAD = 3.0, 0.4


class Async(Rollout):
    """The robot client, watched like any rollout, and its policy server."""

    def __init__(self, commands):
        super().__init__(commands)
        self.server = None
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]

    def start_server(self):
        address = ["--host=127.0.0.1", f"--port={self.port}", f"--fps={FPS}"]
        module = ["-m", "lerobot.async_inference.policy_server", *address]
        self.server = self.commands.start(*module, cwd=self.commands.directory)  # it writes a log where it is
        self.commands.wait(lambda: "PolicyServer started" in self.commands.output(), self.server, 100.0)

    def start_client(self):
        directory = self.commands.directory
        document = config("async")
        del document["duration"]
        path = save_act(directory / "policy", 2, AMPLITUDE_RAD, PERIOD_S, FPS)
        document |= {"server_address": f"127.0.0.1:{self.port}", "pretrained_name_or_path": str(path)}
        document["actions_per_chunk"] = int(0.4 * FPS)
        (directory / "client.yaml").write_text(yaml.safe_dump(document))
        module = ["-m", "lerobot.async_inference.robot_client", f"--config_path={directory / 'client.yaml'}"]
        self.start(*module, cwd=directory)

    def abandon(self):
        super().abandon()
        if self.server is not None:
            self.server.kill()
            self.server.wait()

    def hold_time(self, since, seconds=3.0):
        """How long after `since` (monotonic) a joint moved last, s; looks for so long."""
        last, deadline = since, time.monotonic() + seconds
        while time.monotonic() < deadline:
            state = self.rig.state()
            for channel in FOLLOWERS:
                if np.abs(state["arms"][channel]["dq"]).max() > STILL_RAD_S:
                    last = max(last, state["monotonic_s"])
            time.sleep(0.005)
        return last - since


@pytest.fixture
def asynchronous(commands):
    running = Async(commands)
    yield running
    running.abandon()


@pytest.mark.long
@pytest.mark.parametrize(
    "loss",
    [
        pytest.param(signal.SIGKILL, id="it is killed"),
        pytest.param(signal.SIGSTOP, id="it hangs", marks=pytest.mark.long),
    ],
)
def test_the_arms_hold_when_the_server_goes_and_land_in_the_end(asynchronous, loss, record_property):
    asynchronous.start_server()
    asynchronous.start_client()
    asynchronous.wait_moved(0.2)
    asynchronous.watch(2.0 * PERIOD_S)
    wait_moving(asynchronous)
    os.killpg(asynchronous.server.pid, loss)
    hold_s = asynchronous.hold_time(time.monotonic())
    record_property("hold_s", hold_s)
    assert 0.0 < hold_s < HOLD_S
    output = asynchronous.commands.output()
    assert "left_follower: no target for 0.5 s; it holds" in output
    if loss == signal.SIGKILL:
        assert "Error receiving actions" in output and "UNAVAILABLE" in output  # LeRobot's client says so, and goes on
    assert sorted(asynchronous.commands.enabled()) == sorted(FOLLOWERS)  # held, not dropped
    asynchronous.process.send_signal(signal.SIGINT)
    asynchronous.end()
    asynchronous.assert_ended_well()


def wait_moving(rollout):
    """Wait for a moment in which both arms are under way."""

    def moving():
        arms = rollout.rig.state()["arms"]
        return all(np.abs(arms[channel]["dq"]).max() > 0.1 for channel in FOLLOWERS)

    rollout.wait_until(moving)


@pytest.mark.long
def test_without_a_server_the_client_gives_up_and_lands(asynchronous):
    asynchronous.start_client()
    asynchronous.end()
    assert "Failed to connect to policy server" in asynchronous.commands.output()
    asynchronous.assert_moved(-1.0, at_most_rad=0.05)  # limp, the wrist settles
    asynchronous.assert_ended_well()
