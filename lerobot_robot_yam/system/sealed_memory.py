"""Sealed memory: several processes map it, and no other program can shrink it or write into it.

A mapped file kills its readers (SIGBUS) once a program has truncated it, or its disk is full. A sealed memory file
keeps its size, and has all its pages from the start. The file has no name: its maker passes a descriptor on, and later
processes find a link to `/proc/PID/fd/N` of a process that has the file open. Once mapped, it needs no link.
"""

import contextlib
import ctypes
import fcntl
import mmap
import os
from pathlib import Path

_LIBC = ctypes.CDLL(None, use_errno=True)  # C library: Pythons of uv and conda have no os.memfd_create
_MFD_CLOEXEC, _MFD_ALLOW_SEALING = 1, 2  # flags, from include/uapi/linux/memfd.h
_F_SEAL_FUTURE_WRITE = 0x10  # seal, from include/uapi/linux/fcntl.h, since Linux 5.1; existing mappings stay writable
_FIXED_SIZE = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW
_ONE_WRITER = _F_SEAL_FUTURE_WRITE | fcntl.F_SEAL_SEAL


def allocate(name: str, size: int) -> int:
    """Allocate `size` bytes of zeros, and return their descriptor; `ls -l /proc/PID/fd` shows `name`.

    Raises:
        OSError: no memory or no descriptor is left.
    """
    descriptor = _LIBC.memfd_create(name.encode(), _MFD_CLOEXEC | _MFD_ALLOW_SEALING)
    if descriptor < 0:
        raise OSError(ctypes.get_errno(), f"memfd_create: {os.strerror(ctypes.get_errno())}")
    try:
        os.fchmod(descriptor, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size)
        except OSError as error:  # the error's text names no file
            what = f"no memory for {name}: {error.strerror}; `free -h` and `df -h /dev/shm` show what is full"
            raise OSError(error.errno, what) from error
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _FIXED_SIZE)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def map_to_write(descriptor: int) -> mmap.mmap:
    """Map the memory for its one writer and the writer's children, and seal it against other writers.

    Raises:
        PermissionError: another process has mapped it to write.
    """
    mapped = mmap.mmap(descriptor, os.fstat(descriptor).st_size)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _ONE_WRITER)
    return mapped


def map_to_read(descriptor: int) -> mmap.mmap:
    """Map the memory to read. Raises OSError, ValueError: the size is not sealed, so the memory is not ours."""
    if fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & _FIXED_SIZE != _FIXED_SIZE:
        raise ValueError("its size is not sealed")
    return mmap.mmap(descriptor, os.fstat(descriptor).st_size, prot=mmap.PROT_READ)


def publish(descriptor: int, path: Path) -> str:
    """Link `path` to the memory while this process has the memory open; returns the link's target.

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
    """Remove the link, unless it leads to a successor's memory by now."""
    with contextlib.suppress(OSError):
        if os.readlink(path) == target:
            path.unlink()


def find(path: Path) -> int:
    """Open the memory behind `path` to read, and return its descriptor.

    Raises:
        FileNotFoundError: nothing is published at `path`, or the publisher is gone.
        OSError: the memory cannot be opened.
    """
    return os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOCTTY | os.O_NONBLOCK)
