"""Shared block: one record in memory with one writer and any number of readers, which always get a consistent copy.

The memory is sealed (`sealed_memory`): no other program can shrink it or write to it. The sequence counter is odd
during a write; a checksum detects reordered stores on processors with weakly ordered memory.
"""

import mmap
import os
import struct
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.system import sealed_memory

_HEADER = struct.Struct("<QQII")  # fields: magic, sequence, payload size, checksum of payload
_MAGIC = 0x59414D424C4B3032  # the text "YAMBLK02"
_CHECKSUM = struct.Struct("<I")
_SEQUENCE_AT, _CHECKSUM_AT = slice(8, 16), 20
_LARGE = 16_384  # minimum size at which a payload is checksummed by summing words, bytes: 8 times faster than crc32
_READ_TIMEOUT_S = 0.25  # timeout for a consistent record, s


def allocate(dtype: np.dtype) -> int:
    """Allocate memory for one block of `dtype`, and return its descriptor, for writer and readers.

    Raises:
        OSError: out of memory or descriptors.
    """
    size = np.dtype(dtype).itemsize
    descriptor = sealed_memory.allocate("yam", _HEADER.size + size)
    os.pwrite(descriptor, _HEADER.pack(_MAGIC, 0, size, 0), 0)
    return descriptor


class SharedBlock:
    """Fixed-size record of `dtype` in shared memory.

    Args:
        path: link through which other processes find the block, see `publish`; None: they get its descriptor.
        dtype: a numpy structured dtype (or a plain one with a shape).
        create: True for the writer, False for a reader.
        descriptor: descriptor of the memory, closed with the block; None: a writer allocates memory, a reader opens
            `path`.

    Raises:
        FileNotFoundError: the writer has not started, or has ended.
        StaleStateError: `path` leads to a block with another layout (from another version of this package).
        OSError: the writer gets no memory, or cannot publish the block.
    """

    def __init__(self, path: Path | None, dtype: np.dtype, create: bool, descriptor: int | None = None):
        self.path = path
        self.dtype = np.dtype(dtype)
        self._link = ""  # target of the link at `path`, once this object has published it
        if descriptor is None:
            descriptor = allocate(self.dtype) if create else self._found()
        self.descriptor = descriptor
        try:
            self._map = sealed_memory.map_to_write(descriptor) if create else self._checked(descriptor)
            self._inode = os.fstat(descriptor).st_ino
            if create and path is not None:
                self.publish(path)
        except BaseException:
            os.close(descriptor)
            raise
        # A view stores eight bytes at once. struct would clear them first, and a reader could see the zeros.
        self._sequence = memoryview(self._map)[_SEQUENCE_AT].cast("Q")
        self._payload = memoryview(self._map)[_HEADER.size :]

    def _found(self) -> int:
        assert self.path is not None
        try:
            return sealed_memory.find(self.path)
        except FileNotFoundError:
            raise
        except OSError as error:
            raise StaleStateError(f"{self.path} leads to no block ({error.strerror})") from error

    def _checked(self, descriptor: int) -> mmap.mmap:
        """Map the memory for reading, and check its layout. Raises StaleStateError: the layout differs."""
        try:
            mapped = sealed_memory.map_to_read(descriptor)
            if len(mapped) == _HEADER.size + self.dtype.itemsize:
                magic, _, payload, _ = _HEADER.unpack_from(mapped)
                if magic == _MAGIC and payload == self.dtype.itemsize:
                    return mapped
        except (OSError, ValueError):  # the writer has ended, and another process has its process id
            pass
        raise StaleStateError(f"{self.path} has another layout; end the process that wrote it")

    def publish(self, path: Path) -> None:
        """Link `path` to the block; the link is valid while this process has the block open.

        Raises:
            OSError: the link cannot be created; readers that already have the block are not affected.
        """
        self.path, self._link = path, sealed_memory.publish(self.descriptor, path)

    def adopt(self) -> None:
        """Become the writer, in a child process of a writer that has died; readers are not affected."""
        self._sequence[0] += self._sequence[0] % 2  # odd: the writer died during a write

    def write(self, record: np.ndarray | np.void) -> None:
        """Write one record. Only the writer may call this method."""
        self.write_bytes(record.tobytes())

    def write_bytes(self, payload: bytes | bytearray) -> None:
        """Write one record, given as the bytes of `dtype`. Only the writer may call this method."""
        writing = self._sequence[0] | 1  # already odd if a signal has interrupted the previous write
        self._sequence[0] = writing
        self._map[_HEADER.size :] = payload
        _CHECKSUM.pack_into(self._map, _CHECKSUM_AT, _checksum(payload))
        self._sequence[0] = writing + 1

    def sequence(self) -> int:
        """Return the sequence number of the newest record: even, 0 before the first, odd during a write."""
        return self._sequence[0]

    def read(self) -> np.ndarray | None:
        """Copy the newest record (0-d structured array, writable); None before the first.

        Raises:
            StaleStateError: no consistent record within 0.25 s, since the writer died during a write.
        """
        return self._record(self._wait_for(bytearray))

    def read_bytes(self) -> bytes | None:
        """Copy the newest record as bytes, see `read`."""
        return self._wait_for(bytes)

    def _wait_for[T: (bytes, bytearray)](self, kind: type[T]) -> T | None:
        deadline, stuck = 0.0, 0
        while sequence := self.sequence():
            payload = self._copy(kind)
            if payload is not None:
                return payload
            now = time.monotonic()
            if sequence != stuck:  # the writer is alive: restart the timeout
                deadline, stuck = now + _READ_TIMEOUT_S, sequence
            if now > deadline:
                raise StaleStateError(f"{self.path or 'a block'}: its writer died in the middle of a write")
            time.sleep(0)
        return None

    def glance(self) -> np.ndarray | None:
        """Copy the newest record without waiting; None before the first and during a write."""
        return self._record(self._copy(bytearray))

    def glance_bytes(self) -> bytes | None:
        """Copy the newest record as bytes, see `glance`."""
        return self._copy(bytes)

    def _record(self, payload: bytearray | None) -> np.ndarray | None:
        return None if payload is None else np.frombuffer(payload, self.dtype, count=1).reshape(())

    def _copy[T: (bytes, bytearray)](self, kind: type[T]) -> T | None:
        before = self.sequence()
        if before == 0 or before % 2:
            return None
        payload = kind(self._payload)
        checksum = _CHECKSUM.unpack_from(self._map, _CHECKSUM_AT)[0]
        return payload if self.sequence() == before and _checksum(payload) == checksum else None

    def peek(self, at: int, layout: struct.Struct) -> Any:
        """Read the field with this layout at byte offset `at` of the record, without copying the rest."""
        return layout.unpack_from(self._map, _HEADER.size + at)[0]

    @property
    def current(self) -> bool:
        """Whether `path` still leads to this block."""
        try:
            return self.path is not None and self.path.stat().st_ino == self._inode
        except OSError:
            return False

    def close(self, remove: bool = True) -> None:
        """Unmap the memory and, if `remove` is set, delete the link that this object has published. Idempotent."""
        if self.descriptor < 0:
            return
        self._sequence.release()
        self._payload.release()
        self._map.close()
        if remove and self._link and self.path is not None:
            sealed_memory.unpublish(self.path, self._link)
        os.close(self.descriptor)
        self.descriptor = -1


def _checksum(payload: bytes | bytearray) -> int:
    """Compute a 32-bit checksum: crc32 or, for large payloads, the folded sum of 8-byte words."""
    if len(payload) < _LARGE:
        return zlib.crc32(payload)
    words = len(payload) // 8
    total = int(np.frombuffer(payload, np.uint64, words).sum())
    return zlib.crc32(payload[8 * words :], (total ^ total >> 32) & 0xFFFFFFFF)
