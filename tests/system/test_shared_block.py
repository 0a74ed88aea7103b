"""One writer, readers that see whole records only, whoever dies."""

import ctypes
import fcntl
import mmap
import os
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.system.shared_block import SharedBlock, allocate

DTYPE = np.dtype([("counter", "u8"), ("values", "f8", 64)])


def record(counter):
    out = np.zeros((), DTYPE)
    out["counter"] = counter
    out["values"] = counter
    return out


def test_a_reader_sees_nothing_before_the_first_record_and_the_newest_after(tmp_path):
    writer = SharedBlock(tmp_path / "block", DTYPE, create=True)
    reader = SharedBlock(tmp_path / "block", DTYPE, create=False)
    assert reader.read() is None
    writer.write(record(1))
    writer.write(record(2))
    assert reader.read()["counter"] == 2
    assert reader.sequence() == 4
    reader.close()
    assert (tmp_path / "block").exists()  # a reader's end takes nothing away
    writer.close()
    assert not (tmp_path / "block").is_symlink()


WRITER = """
import itertools, sys, pathlib, numpy as np
sys.path.insert(0, sys.argv[2])
from tests.system.test_shared_block import DTYPE, record
from lerobot_robot_yam.system.shared_block import SharedBlock
writer = SharedBlock(pathlib.Path(sys.argv[1]), DTYPE, create=True)
print("up", flush=True)
for counter in itertools.count(1):
    writer.write(record(counter))
"""


def test_records_are_never_torn(tmp_path, pytestconfig):
    """A writer in another process at full speed, a reader that checks every copy."""
    path = tmp_path / "block"
    child = subprocess.Popen([sys.executable, "-c", WRITER, path, pytestconfig.rootpath], stdout=subprocess.PIPE)
    try:
        child.stdout.readline()
        reader = SharedBlock(path, DTYPE, create=False)
        last = seen = 0
        deadline = time.monotonic() + 20.0  # a busy machine gives a reader few turns
        while child.poll() is None and seen < 1_000 and time.monotonic() < deadline:
            copy = reader.read()
            if copy is not None:
                assert (copy["values"] == copy["counter"]).all()
                assert copy["counter"] >= last
                seen += copy["counter"] > last
                last = copy["counter"]
        reader.close()
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
    assert seen > 100


def test_a_writer_that_died_in_the_middle_is_said_and_not_waited_for_for_ever(tmp_path):
    writer = SharedBlock(tmp_path / "block", DTYPE, create=True)
    writer.write(record(1))
    writer._map[8] = 3  # odd: a write is under way
    reader = SharedBlock(tmp_path / "block", DTYPE, create=False)
    with pytest.raises(StaleStateError, match="died in the middle"):
        reader.read()


def test_a_write_that_was_broken_off_does_not_hide_the_next_ones(tmp_path):
    writer = SharedBlock(tmp_path / "block", DTYPE, create=True)
    reader = SharedBlock(tmp_path / "block", DTYPE, create=False)
    writer.write(record(1))
    writer._sequence[0] += 1  # as a signal's exception leaves it
    writer.write(record(2))
    assert reader.glance()["counter"] == 2


def test_a_glance_never_waits(tmp_path):
    writer = SharedBlock(tmp_path / "block", DTYPE, create=True)
    reader = SharedBlock(tmp_path / "block", DTYPE, create=False)
    assert reader.glance() is None
    writer.write(record(1))
    assert reader.glance() == record(1)
    writer._map[8] = 3  # a write is under way
    assert reader.glance() is None
    writer._map[8], writer._map[-1] = 4, writer._map[-1] ^ 1  # not what the checksum says
    assert reader.glance() is None


@pytest.mark.parametrize("size, at", [(230_424, 24), (230_424, 230_423), (16_389, 16_388)])
def test_a_large_record_that_is_torn_is_not_read(tmp_path, size, at):
    dtype = np.dtype([("picture", np.uint8, (size,))])
    writer = SharedBlock(tmp_path / "block", dtype, create=True)
    reader = SharedBlock(tmp_path / "block", dtype, create=False)
    picture = np.zeros((), dtype)
    picture["picture"] = np.random.default_rng(0).integers(256, size=size)
    writer.write(picture)
    copy = reader.glance()
    assert copy == picture
    copy["picture"][:] = 0  # its own
    assert reader.glance() == picture
    writer._map[24 + at] ^= 1
    assert reader.glance() is None


def test_another_layout_is_refused(tmp_path):
    writer = SharedBlock(tmp_path / "block", DTYPE, create=True)
    with pytest.raises(StaleStateError, match="another layout"):
        SharedBlock(tmp_path / "block", np.dtype([("x", "f8")]), create=False)
    writer.close()


def test_a_successors_block_is_not_removed_by_its_predecessor(tmp_path):
    first = SharedBlock(tmp_path / "block", DTYPE, create=True)
    second = SharedBlock(tmp_path / "block", DTYPE, create=True)
    first.close()
    assert (tmp_path / "block").exists()
    second.close()
    assert not (tmp_path / "block").is_symlink()


def test_threads_may_read_at_once(tmp_path):
    writer = SharedBlock(tmp_path / "block", DTYPE, create=True)
    writer.write(record(7))
    reader = SharedBlock(tmp_path / "block", DTYPE, create=False)
    found = []
    threads = [threading.Thread(target=lambda: found.append(reader.read()["counter"])) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [7] * 8


def attacks(descriptor):
    """What a program may try with a file that it has opened for writing."""
    return {
        "shrink": lambda: os.ftruncate(descriptor, 0),
        "grow": lambda: os.ftruncate(descriptor, 1 << 20),
        "write": lambda: os.pwrite(descriptor, bytes(64), 0),
        "map": lambda: mmap.mmap(descriptor, 64),
        "punch a hole": lambda: punch_a_hole(descriptor),
        "seal": lambda: fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_WRITE),
    }


def punch_a_hole(descriptor):
    keep_size, punch = 1, 2  # linux/falloc.h
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.fallocate(descriptor, keep_size | punch, ctypes.c_long(0), ctypes.c_long(4096)):
        raise OSError(ctypes.get_errno(), "fallocate")


@pytest.mark.parametrize("attack", attacks(-1))
def test_no_other_process_can_shrink_a_block_or_write_into_it(tmp_path, attack):
    writer = SharedBlock(tmp_path / "block", DTYPE, create=True)
    reader = SharedBlock(tmp_path / "block", DTYPE, create=False)
    writer.write(record(1))
    for path in (tmp_path / "block", f"/proc/self/fd/{writer.descriptor}"):
        opened = os.open(path, os.O_RDWR)
        with pytest.raises(PermissionError):
            attacks(opened)[attack]()
        os.close(opened)
    assert reader.read() == record(1)
    writer.write(record(2))
    assert reader.read() == record(2)
    writer.close()
    reader.close()


def test_a_reader_that_has_a_block_needs_its_link_no_more(tmp_path):
    writer = SharedBlock(tmp_path / "block", DTYPE, create=True)
    reader = SharedBlock(tmp_path / "block", DTYPE, create=False)
    (tmp_path / "block").unlink()
    (tmp_path / "block").mkdir()
    writer.write(record(1))
    assert reader.read() == record(1)
    with pytest.raises(StaleStateError, match="another layout"):
        SharedBlock(tmp_path / "block", DTYPE, create=False)
    writer.close()  # what it has not put there it does not remove
    assert (tmp_path / "block").is_dir()


@pytest.mark.parametrize("left", ["nothing", "a file", "a socket"])
def test_the_number_of_a_dead_writer_that_was_given_again_is_no_block(tmp_path, left):
    here, there = socket.socketpair()
    file = os.open(__file__, os.O_RDONLY)
    number = {"nothing": 2**20, "a file": file, "a socket": here.fileno()}[left]
    (tmp_path / "block").symlink_to(f"/proc/{os.getpid()}/fd/{number}")
    with pytest.raises(FileNotFoundError if left == "nothing" else StaleStateError):
        SharedBlock(tmp_path / "block", DTYPE, create=False)
    os.close(file)
    here.close()
    there.close()


def test_a_child_goes_on_with_the_block_of_a_writer_that_died_in_the_middle(tmp_path):
    reader = SharedBlock(None, DTYPE, False, allocate(DTYPE))
    writer = SharedBlock(None, DTYPE, True, os.dup(reader.descriptor))
    writer.write(record(1))
    writer._sequence[0] += 1  # a write is under way
    child = os.fork()
    if child == 0:
        writer.adopt()
        writer.write(record(2))
        os._exit(0)
    os.waitpid(child, 0)
    assert reader.read() == record(2)
    writer.close()
    reader.close()
