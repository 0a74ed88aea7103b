"""lerobot-rollout at 30 Hz, driven by yam-policy-server: a checkpoint in a process of its own."""

import re
import signal
import time

import pytest

from tests.cli.test_openpi_rollout import ServedRollout
from tests.policy_plugin.checkpoints import save_act

pytestmark = [pytest.mark.long, pytest.mark.alone]

FPS, STEPS, DURATION_S = 30, 10, 10
AMPLITUDE_RAD, PERIOD_S = 0.4, 3.0


class Server:
    """The command, serving an ACT whose arms swing."""

    def __init__(self, commands):
        path = save_act(commands.directory / "policy", 2, AMPLITUDE_RAD, PERIOD_S, FPS)
        options = [f"--policy.path={path}", "--port=0", f"--policy.n_action_steps={STEPS}"]
        self.commands, self.process = commands, commands.start("yam-policy-server", *options)
        deadline = time.monotonic() + 100.0
        while not (told := re.search(r"listening on ws://127.0.0.1:(\d+)", commands.output())):
            assert time.monotonic() < deadline and self.process.poll() is None, commands.output()[-4000:]
            time.sleep(0.1)
        self.port = int(told[1])

    def end(self):
        """Ctrl-C; returns the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.commands.finish(self.process)


@pytest.mark.parametrize("engine", ["sync", "rtc"])
def test_a_checkpoint_drives_the_arms_from_its_server(commands, engine, record_property):
    server = Server(commands)
    options = [f"--fps={FPS}", f"--duration={DURATION_S}", f"--policy.n_action_steps={STEPS}"]
    if engine == "rtc":
        options += ["--inference.type=rtc", f"--inference.queue_threshold={STEPS // 2}"]
    rollout = ServedRollout(commands)
    try:
        rollout.begin(server, *options)
        assert rollout.end() == 0, commands.output()[-4000:]
    finally:
        rollout.abandon()
    assert server.end() == 0
    rollout.assert_moved(0.6 * AMPLITUDE_RAD)
    answers, seconds = re.search(r"has gone after (\d+) answers in ([\d.]+) s,", commands.output()).groups()
    record_property("answers", int(answers))
    record_property("ticks_too_long", commands.output().count("Record loop is running slower"))
    assert float(seconds) > DURATION_S
    assert int(answers) * STEPS > 0.5 * DURATION_S * FPS  # a machine with busy neighbours does less than the rate
    rollout.assert_ended_well()
