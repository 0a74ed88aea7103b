"""Memory that several processes map, and that no other program can shrink or write into.

A mapped file kills its readers once a program has truncated it, or its disk is full (SIGBUS). A sealed memory
file has a size for good, and its pages from the start. It has no name either: it is handed on as a descriptor, and for
later processes a link leads to the descriptor of a process that has it open (`/proc/PID/fd/N`). A process that has
mapped the memory does not depend on the link.
"""

import contextlib
import ctypes
import fcntl
import mmap
import os
from pathlib import Path

_LIBC = ctypes.CDLL(None, use_errno=True)  # Pythons of uv and conda have no os.memfd_create
_MFD_CLOEXEC, _MFD_ALLOW_SEALING = 1, 2  # include/uapi/linux/memfd.h
_F_SEAL_FUTURE_WRITE = 0x10  # include/uapi/linux/fcntl.h, since Linux 5.1; mappings that exist stay writable
_FIXED_SIZE = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW
_ONE_WRITER = _F_SEAL_FUTURE_WRITE | fcntl.F_SEAL_SEAL


def allocate(name: str, size: int) -> int:
    """A descriptor of `size` bytes of zeros; `name` is what `ls -l /proc/PID/fd` shows.

    Raises:
        OSError: there is no memory, or no descriptor left.
    """
    descriptor = _LIBC.memfd_create(name.encode(), _MFD_CLOEXEC | _MFD_ALLOW_SEALING)
    if descriptor < 0:
        raise OSError(ctypes.get_errno(), f"memfd_create: {os.strerror(ctypes.get_errno())}")
    try:
        os.fchmod(descriptor, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size)
        except OSError as error:  # it names no file
            what = f"no memory for {name}: {error.strerror}; `free -h` and `df -h /dev/shm` show what is full"
            raise OSError(error.errno, what) from error
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _FIXED_SIZE)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def map_to_write(descriptor: int) -> mmap.mmap:
    """The only mapping through which the memory can be written from now on; children inherit it.

    Raises:
        PermissionError: another process has it already.
    """
    mapped = mmap.mmap(descriptor, os.fstat(descriptor).st_size)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _ONE_WRITER)
    return mapped


def map_to_read(descriptor: int) -> mmap.mmap:
    """A mapping to read from. Raises OSError, ValueError: this is no memory of ours, whose size never changes."""
    if fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & _FIXED_SIZE != _FIXED_SIZE:
        raise ValueError("its size is not sealed")
    return mmap.mmap(descriptor, os.fstat(descriptor).st_size, prot=mmap.PROT_READ)


def publish(descriptor: int, path: Path) -> str:
    """Let others find the memory by `path` as long as this process has it open; returns where that leads.

    Raises:
        OSError: the link cannot be made.
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
    """Remove the link, unless it leads elsewhere by now: to a successor's memory."""
    with contextlib.suppress(OSError):
        if os.readlink(path) == target:
            path.unlink()


def find(path: Path) -> int:
    """A descriptor, to read from, of what `path` leads to.

    Raises:
        FileNotFoundError: it is not published, or its publisher is gone.
        OSError: it cannot be opened.
    """
    return os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOCTTY | os.O_NONBLOCK)
