"""Sealed memory: several processes map it, and no other program can shrink it or write to it.

With a mapped file, readers are killed (SIGBUS) once a program truncates the file or its disk is full. A sealed memory
file keeps its size and has all its pages from the start. The file has no name: its creator passes the descriptor on,
or later processes follow a link to `/proc/PID/fd/N` of a process that has it open. Existing mappings need no link.
"""

import contextlib
import ctypes
import fcntl
import mmap
import os
from pathlib import Path

_LIBC = ctypes.CDLL(None, use_errno=True)  # C library: Pythons from uv and conda lack os.memfd_create
_MFD_CLOEXEC, _MFD_ALLOW_SEALING = 1, 2  # flags, from include/uapi/linux/memfd.h
_F_SEAL_FUTURE_WRITE = 0x10  # seal, from include/uapi/linux/fcntl.h, since Linux 5.1; existing mappings stay writable
_FIXED_SIZE = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW
_ONE_WRITER = _F_SEAL_FUTURE_WRITE | fcntl.F_SEAL_SEAL


def allocate(name: str, size: int) -> int:
    """Allocate `size` zero bytes, and return their descriptor; `name` is shown by `ls -l /proc/PID/fd`.

    Raises:
        OSError: out of memory or descriptors.
    """
    descriptor = _LIBC.memfd_create(name.encode(), _MFD_CLOEXEC | _MFD_ALLOW_SEALING)
    if descriptor < 0:
        raise OSError(ctypes.get_errno(), f"memfd_create: {os.strerror(ctypes.get_errno())}")
    try:
        os.fchmod(descriptor, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size)
        except OSError as error:  # the error's text does not name a file
            what = f"no memory for {name}: {error.strerror}; `free -h` and `df -h /dev/shm` show what is full"
            raise OSError(error.errno, what) from error
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _FIXED_SIZE)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def map_to_write(descriptor: int) -> mmap.mmap:
    """Map the memory for writing by this process and its children, and seal it against other writers.

    Raises:
        PermissionError: another process has mapped the memory for writing.
    """
    mapped = mmap.mmap(descriptor, os.fstat(descriptor).st_size)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _ONE_WRITER)
    return mapped


def map_to_read(descriptor: int) -> mmap.mmap:
    """Map the memory for reading. Raises OSError, ValueError: its size is not sealed, so it is not from `allocate`."""
    if fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & _FIXED_SIZE != _FIXED_SIZE:
        raise ValueError("its size is not sealed")
    return mmap.mmap(descriptor, os.fstat(descriptor).st_size, prot=mmap.PROT_READ)


def publish(descriptor: int, path: Path) -> str:
    """Link `path` to the memory while this process has the memory open; return the link's target.

    Raises:
        OSError: the link cannot be created.
    """
    target = f"/proc/{os.getpid()}/fd/{descriptor}"
    scratch = path.with_name(f"{path.name}.{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        scratch.unlink()
    scratch.symlink_to(target)
    try:
        scratch.rename(path)
    except OSError:
        scratch.unlink(missing_ok=True)
        raise
    return target


def unpublish(path: Path, target: str) -> None:
    """Remove the link, unless it already leads to the memory of a successor."""
    with contextlib.suppress(OSError):
        if os.readlink(path) == target:
            path.unlink()


def find(path: Path) -> int:
    """Open the memory published at `path` for reading, and return its descriptor.

    Raises:
        FileNotFoundError: nothing is published at `path`, or the publisher has ended.
        OSError: the memory cannot be opened.
    """
    return os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOCTTY | os.O_NONBLOCK)
