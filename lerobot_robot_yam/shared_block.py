"""One record in a memory-mapped file: one writer, any number of readers, always a consistent copy.

Not `multiprocessing.shared_memory`: in Python 3.12 any attached reader's exit unlinks the block. The sequence
counter is odd while a write is under way; the checksum catches what a weakly ordered memory may reorder.
"""

import contextlib
import mmap
import os
import struct
import time
import zlib
from pathlib import Path

import numpy as np

from lerobot_robot_yam.errors import StaleStateError

_HEADER = struct.Struct("<QQII")  # magic, sequence, payload size, crc32 of payload
_MAGIC = 0x59414D424C4B3031  # "YAMBLK01"
_CRC = struct.Struct("<I")
_FIELD = struct.Struct("<Q")
_FLOAT = struct.Struct("<d")
_SEQUENCE_AT, _CRC_AT = slice(8, 16), 20
_READ_TIMEOUT_S = 0.25


class SharedBlock:
    """A fixed-size record of `dtype` shared through `path`.

    Args:
        path: the backing file.
        dtype: a numpy structured dtype (or a plain one with a shape).
        create: True for the one writer, which creates the file; False for a reader.
        adopt: become the writer of a block whose writer has died; readers go on as if nothing had happened.

    Raises:
        FileNotFoundError: a reader came before the writer.
        StaleStateError: the file is not a block of this layout (another version of this package wrote it).
    """

    def __init__(self, path: Path, dtype: np.dtype, create: bool, adopt: bool = False):
        self.path = path
        self.dtype = np.dtype(dtype)
        self._owner = create or adopt
        size = _HEADER.size + self.dtype.itemsize
        if create:
            scratch = path.with_name(f"{path.name}.{os.getpid()}")
            with open(scratch, "w+b") as file:
                os.fchmod(file.fileno(), 0o600)
                file.write(_HEADER.pack(_MAGIC, 0, self.dtype.itemsize, 0))
                file.truncate(size)
                file.flush()
                self._map = mmap.mmap(file.fileno(), size)
                self._inode = os.fstat(file.fileno()).st_ino
            scratch.rename(path)  # readers see a whole block or none
        else:
            with open(path, "r+b" if adopt else "rb") as file:
                if os.fstat(file.fileno()).st_size != size:
                    raise StaleStateError(f"{path} has another layout; end the process that wrote it")
                access = mmap.PROT_READ | (mmap.PROT_WRITE if adopt else 0)
                self._map = mmap.mmap(file.fileno(), size, prot=access)
                self._inode = os.fstat(file.fileno()).st_ino
            magic, _, payload, _ = _HEADER.unpack_from(self._map)
            if magic != _MAGIC or payload != self.dtype.itemsize:
                raise StaleStateError(f"{path} has another layout; end the process that wrote it")
        # A view stores eight bytes in one go; struct clears them first, and a reader could see that.
        self._sequence = memoryview(self._map)[_SEQUENCE_AT].cast("Q")
        if adopt and self._sequence[0] % 2:  # it died in the middle of a write
            self._sequence[0] += 1

    def write(self, record: np.ndarray | np.void) -> None:
        """Publish one record. Only the creator may call this."""
        self.write_bytes(record.tobytes())

    def write_bytes(self, payload: bytes) -> None:
        """Publish one record, given as the bytes of `dtype`. Only the creator may call this."""
        writing = self._sequence[0] | 1  # odd already where a signal has broken off the last one
        self._sequence[0] = writing
        self._map[_HEADER.size :] = payload
        _CRC.pack_into(self._map, _CRC_AT, zlib.crc32(payload))
        self._sequence[0] = writing + 1

    def sequence(self) -> int:
        """Number of the newest record; even, 0 before the first, odd while one is being written."""
        return self._sequence[0]

    def read(self) -> np.ndarray | None:
        """A consistent private copy of the newest record (0-d structured array), None before the first.

        Raises:
            StaleStateError: no consistent record within 0.25 s: the writer died in the middle of a write.
        """
        return self._record(self.read_bytes())

    def read_bytes(self) -> bytes | None:
        """The same as the bytes of `dtype`."""
        deadline, stuck = 0.0, 0
        while sequence := self.sequence():
            payload = self._copy()
            if payload is not None:
                return payload
            now = time.monotonic()
            if sequence != stuck:  # whoever writes on is alive: it is we who were held up
                deadline, stuck = now + _READ_TIMEOUT_S, sequence
            if now > deadline:
                raise StaleStateError(f"{self.path}: its writer died in the middle of a write")
            time.sleep(0)
        return None

    def glance(self) -> np.ndarray | None:
        """As `read` without waiting: None also while a record is being written, for who must not be held up."""
        return self._record(self._copy())

    def _record(self, payload: bytes | None) -> np.ndarray | None:
        return None if payload is None else np.frombuffer(payload, self.dtype, count=1).reshape(())

    def _copy(self) -> bytes | None:
        before = self.sequence()
        if before == 0 or before % 2:
            return None
        payload = self._map[_HEADER.size :]
        crc = _CRC.unpack_from(self._map, _CRC_AT)[0]
        return payload if self.sequence() == before and zlib.crc32(payload) == crc else None

    def peek(self, at: int) -> int:
        """The unsigned 8-byte field at byte `at` of the record as it is now, without a copy of the rest."""
        value: int = _FIELD.unpack_from(self._map, _HEADER.size + at)[0]
        return value

    def peek_float(self, at: int) -> float:
        """The same of a field that holds a float."""
        value: float = _FLOAT.unpack_from(self._map, _HEADER.size + at)[0]
        return value

    @property
    def current(self) -> bool:
        """False when the file has been removed or replaced since."""
        try:
            return self.path.stat().st_ino == self._inode
        except FileNotFoundError:
            return False

    def close(self, remove: bool | None = None) -> None:
        """Unmap, and remove the file; None: if this is its writer."""
        self._sequence.release()
        self._map.close()
        if (self._owner if remove is None else remove) and self.current:  # a successor may have put its own block here
            with contextlib.suppress(FileNotFoundError):
                self.path.unlink()
