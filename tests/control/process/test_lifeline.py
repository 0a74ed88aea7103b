"""How a process that holds arms learns that its caller is gone, whose pid may live on."""

import os
import signal
import subprocess
import sys

from lerobot_robot_yam.rig.control import runs

WATCHER = """
import sys
from lerobot_robot_yam.control.process.lifeline import hung_up
line = int(sys.argv[1])
print("gone" if hung_up(line, 0.0) else "there", flush=True)
print("gone" if hung_up(line, 20.0) else "there", flush=True)
"""
CALLER = f"""
import os, subprocess, sys, time
from lerobot_robot_yam.control.process.lifeline import Lifeline
line = Lifeline()
subprocess.Popen([sys.executable, "-c", {WATCHER!r}, str(line.far_end)], pass_fds=[line.far_end])
line.hand_over()
child = os.fork()
if child == 0:
    time.sleep(60)  # it was to hold nothing of its parent's
sys.stdin.readline()
print(child, flush=True)
os.execvp("sleep", ["sleep", "60"])
"""


def test_a_caller_that_executes_another_program_is_gone_although_it_runs_and_has_a_child():
    caller = subprocess.Popen(
        [sys.executable, "-c", CALLER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert caller.stdout.readline() == "there\n"
        caller.stdin.write("\n")
        caller.stdin.flush()
        child = int(caller.stdout.readline())
        assert caller.stdout.readline() == "gone\n"
        assert caller.poll() is None and runs(child)
    finally:
        os.killpg(caller.pid, signal.SIGKILL)
        caller.communicate()
