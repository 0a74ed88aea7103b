"""A rollout under observation: a command on the rig, keys pressed in its terminal, what the rig sees of the arms."""

import os
import pty
import time

import numpy as np
import pytest
import yaml

from scripts import recorders
from tests.cli.conftest import ROOT
from tests.policy_plugin.checkpoints import save_scripted

FOLLOWERS = ("follower_left", "follower_right")
FPS = 15  # what a machine with two cores manages beside the physics
PLUGIN = "--robot.discover_packages_path=tests.policy_plugin"
# The profiles' limit on the set-point, and what the arm itself may exceed it by; as scripts/soak/truth.py has it.
SPEED_LIMIT_RAD_S, SPEED_FACTOR, SPEED_SLACK_RAD_S = 1.5, 1.2, 0.15
BUSY_FACTOR = 2.0  # when the physics had no CPU for a while, commands came to it in heaps


class Rollout:
    """One stock command, from start to end.

    Attributes:
        channels: the followers that it drives.
        rest: (6,) of each follower before.
        farthest: how far each was seen from there, rad.
    """

    def __init__(self, commands, channels=FOLLOWERS):
        self.commands, self.rig, self.channels = commands, commands.rig, channels
        self.root = commands.directory / "data"
        self.rest = {channel: self.joints(channel) for channel in FOLLOWERS}
        self.farthest = dict.fromkeys(FOLLOWERS, 0.0)
        self.process = self._terminal = None
        self._slips = None  # of the physics, before the arms moved
        for channel in FOLLOWERS:
            recorders.watch_start(self.rig, channel)

    def joints(self, channel):
        """Where an arm is, (6,)."""
        return np.array(self.rig.state()["arms"][channel]["q"])

    def begin(self, document, behaviour, *arguments, **fields):
        """Start lerobot-rollout with a config, and a checkpoint that behaves so."""
        directory = self.commands.directory
        path = save_scripted(directory / "policy", behaviour, arms=len(self.channels), fps=FPS, chunk_size=15, **fields)
        config = directory / "rollout.yaml"
        config.write_text(yaml.safe_dump(document))
        self.start("lerobot-rollout", f"--config_path={config}", PLUGIN, f"--policy.path={path}", *arguments)

    def start(self, *command, cwd=ROOT):
        """Start a command in a terminal of its own."""
        self._terminal, stdin = pty.openpty()
        try:
            self.process = self.commands.start(*command, stdin=stdin, cwd=cwd)
        finally:
            os.close(stdin)

    def press(self, key):
        """Press a key in its terminal."""
        os.write(self._terminal, key.encode())

    def watch(self, seconds):
        """Look at the arms for so long."""
        deadline = time.monotonic() + seconds
        self.wait_until(lambda: time.monotonic() > deadline)

    def wait_said(self, text, count=1):
        """Look at the arms until it has printed something, so many times."""
        self.wait_until(lambda: self.commands.output().count(text) >= count)

    def wait_until(self, condition, timeout_s=60.0):
        """Look at the arms, how far from their rest they get, until a condition holds."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if self._slips is None and any(
                recorders.watch(self.rig, channel)["enabled_events"] for channel in self.channels
            ):
                self._slips = self.rig.stats()["slips"]
            for channel in FOLLOWERS:
                away = float(np.abs(self.joints(channel) - self.rest[channel]).max())
                self.farthest[channel] = max(self.farthest[channel], away)
            ended = self.process.poll() is not None
            if (ended and not condition()) or time.monotonic() > deadline:
                pytest.fail(f"it has {'ended' if ended else 'hung'}:\n{self.commands.output()[-4000:]}")
            time.sleep(0.05)

    def wait_moved(self, at_least_rad):
        """Look at the arms until each that it drives has been so far from its rest."""
        self.wait_until(lambda: all(self.farthest[channel] > at_least_rad for channel in self.channels))

    def way(self, channel, seconds):
        """How far a follower goes in a while, rad."""
        seen, until_s = [], time.monotonic() + seconds
        self.wait_until(lambda: seen.append(self.joints(channel)) or time.monotonic() > until_s)
        return float(np.ptp(seen, axis=0).max())

    def end(self):
        """Look on until it ends, then close its terminal; returns its exit status."""
        self.wait_until(lambda: self.process.poll() is not None)
        self._hang_up()
        return self.process.wait()

    def abandon(self):
        """Whatever has become of it: leave nothing behind. Only the end of the rig is sure to end torque."""
        self._hang_up()
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()
            self.rig.end()

    def _hang_up(self):
        terminal, self._terminal = self._terminal, None
        if terminal is not None:
            os.close(terminal)

    def assert_moved(self, at_least_rad, at_most_rad=np.inf):
        """Each arm that it drives has left its rest by so much, no other arm has moved."""
        for channel in FOLLOWERS:
            if channel in self.channels:
                assert at_least_rad < self.farthest[channel] < at_most_rad, (channel, self.farthest)
            else:
                assert self.farthest[channel] < 0.1, (channel, self.farthest)  # limp, it settles

    def assert_within_speed(self, channels):
        """No joint of these arms was faster than its limit since the rig watches it, and none had a fault."""
        factor = SPEED_FACTOR if self.rig.stats()["slips"] == (self._slips or 0) else BUSY_FACTOR
        allowed = factor * SPEED_LIMIT_RAD_S + SPEED_SLACK_RAD_S
        for channel in channels:
            seen = recorders.watch(self.rig, channel)
            assert seen["enabled_events"] and not seen["fault_events"]
            assert max(seen["max_speed_rad_s"][:6]) < allowed, (channel, seen, self.rig.stats()["slips"])

    def assert_ended_well(self):
        """No joint was faster than its limit; all arms have landed."""
        self.assert_within_speed(self.channels)
        self.commands.assert_landed()


def config(name, **fields):
    """A shipped config of the virtual rig, at a rate that a test machine manages, without pictures."""
    document = yaml.safe_load((ROOT / "configs" / "sim" / f"{name}.yaml").read_text())
    return document | {"fps": FPS, "duration": 0} | fields


def one_arm(document):
    """The same for the left arms alone."""
    for device, kind in (("robot", "yam_follower"), ("teleop", "yam_leader")):
        if device in document:
            document[device] = {"type": kind, "id": "sim", **document[device]["left_arm_config"]}
    return document


def data_set(root, **fields):
    """Options of a data set that a rollout is to record."""
    options = {"repo_id": "local/rollout_test", "root": str(root), "no_stamp": True, "single_task": "none"}
    return options | {"fps": FPS, "push_to_hub": False, "streaming_encoding": True} | fields
