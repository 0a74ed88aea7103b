"""What the kernel grants, asked for in a process of its own so that the tests' process stays ordinary."""

import os
import platform
import subprocess
import sys

import pytest

ASK = """
import os
from lerobot_robot_yam.system.realtime import request_realtime
print(request_realtime(1))
child = os.fork()
if child == 0:
    os._exit(os.sched_getscheduler(0))
print(os.sched_getscheduler(0), os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_it_reports_what_was_granted_and_children_are_ordinary():
    answer = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, check=True)
    granted, policies = answer.stdout.splitlines()
    own, childs = (int(text) for text in policies.split())
    assert ("SCHED_FIFO 1" in granted) == (own & 0xFF == os.SCHED_FIFO)  # the rest are flags
    assert ("memory locked" in granted) != ("memory not locked" in granted)
    assert childs == 0


KERNEL = tuple(int(part) for part in platform.release().split(".")[:2])


@pytest.mark.skipif(os.getuid() != 0 or KERNEL < (6, 12), reason="drops root's privilege; short slices need 6.12")
def test_without_privilege_it_gets_short_slices():
    ask = (
        "import os; from lerobot_robot_yam.system import realtime as r; os.setuid(65534); print(r.request_realtime(1))"
    )
    answer = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    assert answer.stdout.startswith("normal scheduling with 0.1 ms slices, memory ")


GIVE_WAY = """
import os
from lerobot_robot_yam.system.realtime import give_way
give_way()
print(os.sched_getscheduler(0) == os.SCHED_BATCH, os.getpriority(os.PRIO_PROCESS, 0))
if os.path.exists("/proc/self/autogroup"):
    print(open("/proc/self/autogroup").read().split()[-1])
"""


def test_a_process_that_gives_way_does_so_for_its_session():
    ask = [sys.executable, "-c", GIVE_WAY]
    answer = subprocess.run(ask, capture_output=True, text=True, check=True, start_new_session=True)
    policy, nice, *session = answer.stdout.split()
    assert policy == "True"
    assert int(nice) > 0
    assert session in ([], [nice])


LOCK = """
import ctypes, mmap
from lerobot_robot_yam.system.realtime import request_realtime

def loaded(memory):
    address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    pages = (ctypes.c_ubyte * (len(memory) // mmap.PAGESIZE))()
    assert ctypes.CDLL(None).mincore(ctypes.c_void_p(address), ctypes.c_size_t(len(memory)), pages) == 0
    return sum(page & 1 for page in pages) / len(pages)

block, buffer = mmap.mmap(-1, 1 << 20), mmap.mmap(-1, 32 << 20, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
granted = request_realtime(1)
print("memory locked" in granted, loaded(block), loaded(buffer))
"""


def test_locked_memory_is_loaded_but_not_what_is_only_reserved():
    answer = subprocess.run([sys.executable, "-c", LOCK], capture_output=True, text=True, check=True)
    locked, block, buffer = answer.stdout.split()
    if locked != "True":
        pytest.skip("locked memory needs RLIMIT_MEMLOCK")
    assert float(block) == 1.0 and float(buffer) < 0.2
