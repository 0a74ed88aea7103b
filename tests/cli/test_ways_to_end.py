"""Every signal in every phase of a recording: exit status, last line, what is kept, and that all arms land.

The default tier runs a spread, `-m long` all.
"""

import os
import signal
import time

import pytest

from tests.cli.test_interrupted_recording import CONNECTING, ENDS_S, Recording, assert_episodes, kept, running

pytestmark = pytest.mark.alone

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# What is printed when the phase begins, and how many episodes are kept when a signal comes in it.
PHASES = {
    "connecting": (CONNECTING, 0),
    "first episode": ("Recording episode 0", 0),
    "second episode": ("Recording episode 1", 1),
    "resetting": ("Reset the environment", 1),
    "landing": ("Reset the environment", 1),
}
SHORT = [("landing", signal.SIGTERM)]  # that it was ended by SIGINT shows that the first signal ended it
WAYS = [
    pytest.param(phase, number, id=f"{phase}-{number.name}", marks=[] if (phase, number) in SHORT else pytest.mark.long)
    for phase in PHASES
    for number in SIGNALS
]


@pytest.mark.parametrize(("phase", "number"), WAYS)
def test_a_signal_ends_a_recording_in_any_phase(commands, phase, number):
    begins, count = PHASES[phase]
    recording = Recording(commands, reset_s=60, until=begins)
    with running(recording):
        begin = time.monotonic()
        if phase == "landing":
            os.killpg(recording.process.pid, signal.SIGINT)
            time.sleep(2.0)
        os.killpg(recording.process.pid, number)
        assert commands.finish(recording.process) == -signal.SIGINT, recording.output()[-4000:]
        assert time.monotonic() - begin < ENDS_S + (2.0 if phase == "landing" else 0.0)
        commands.assert_landed()
        if count:
            assert kept(recording).endswith(f"kept {count} episode of this session; {count} in {recording.root}")
            assert_episodes(recording.root, count)
            assert f"\nended by {signal.SIGINT.name if phase == 'landing' else number.name}\n" in recording.output()
        else:
            assert kept(recording).endswith(f"removed the empty data set {recording.root}")
            assert not recording.root.exists()
        assert "Traceback" not in recording.output()
