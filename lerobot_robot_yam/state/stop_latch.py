"""Latches of the emergency stop of one user's arms: a directory, with a file for each source that has stopped them.

The arms are stopped while the directory exists. A source releases its own file only; the directory goes with the last
file, and the kernel removes no directory that still has one. If nothing can be created because of a full disk or a lack
of file descriptors, the sticky bit of the runtime directory is the latch of a source without a name.

This module imports next to nothing, because `yam-estop` must not wait for imports.
"""

import errno
import os
import stat
import time

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.runtime_dirs import make_runtime_dir

OWN, ROOT = "yam-estop", "root"  # sources of `yam-estop`: as the arms' user, and as root for another user's arms
UNKNOWN = "unknown"  # source of a latch without a file
_DIRECTORY = "emergency-stop"
_MOST_BYTES = 4096  # maximum number of bytes read from a file, and of bytes shown
_MOST_NAME = 120  # maximum length of a source's name, characters
_OPEN = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM)  # error codes of a full disk
_NO_DESCRIPTOR = (errno.EMFILE, errno.ENFILE)  # error codes of a lack of file descriptors
_NO_ROOM = "unknown: there was no room to write it down"
_TRIES = 100  # attempts to latch while other sources release the last latch


def source_name(text: str) -> str:
    """Return the name of a source as it can be typed and be a file's name."""
    name = "".join(c if c.isascii() and (c.isalnum() or c in "_.:@-") else "-" for c in text)[:_MOST_NAME]
    return name if name[:1].isalnum() else f"_{name}"


class StopLatch:
    """Latches of the emergency stop in one runtime directory.

    Args:
        directory: runtime directory of the user whose arms are stopped; None: this user's.

    Attributes:
        directory: path of the runtime directory.

    Raises:
        ConfigError: no runtime directory can be created for this user.
    """

    def __init__(self, directory: str | os.PathLike[str] | None = None) -> None:
        self._own = directory is None
        self.directory = make_runtime_dir() if directory is None else os.fspath(directory)
        self._name = f"{self.directory}/{_DIRECTORY}"

    @property
    def latched(self) -> bool:
        """Whether any source has latched the emergency stop."""
        return os.access(self._name, os.F_OK) or self._marked

    @property
    def _marked(self) -> bool:
        """Whether the runtime directory has the sticky bit."""
        try:
            return bool(os.lstat(self.directory).st_mode & stat.S_ISVTX)
        except OSError:
            return False

    def names(self) -> list[str]:
        """Return the names of the sources that have latched the stop; empty if it is not latched."""
        try:
            found = sorted(os.listdir(self._name)) or [UNKNOWN]
        except OSError:
            found = [UNKNOWN] if os.access(self._name, os.F_OK) else []
        return [*found, UNKNOWN] if self._marked and UNKNOWN not in found else found

    def sources(self) -> dict[str, str]:
        """Return for each source that has latched the stop its reason, process and time."""
        return {name: self._text(name) for name in self.names()}

    def reason(self) -> str:
        """Return reason, process and time of all latches; empty if not latched."""
        return "; ".join(self.sources().values())

    def _text(self, source: str) -> str:
        if source == UNKNOWN:
            return _NO_ROOM
        try:
            with _Directory(self.directory) as runtime, _Directory(_DIRECTORY, runtime) as inside:
                file = os.open(source, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=inside)
                try:
                    text = os.read(file, _MOST_BYTES).decode(errors="replace")
                finally:
                    os.close(file)
        except OSError:
            return UNKNOWN
        return "".join(c if c.isprintable() else "?" for c in text) or UNKNOWN

    def latch(self, why: str, source: str = OWN) -> None:
        """Latch the stop for a source, until its `release`. The source's first reason stays.

        Raises:
            OSError: the latch cannot be written.
        """
        if self._own:
            try:
                make_runtime_dir()  # recreates the directory if a log-out has removed it
            except ConfigError:
                pass
        try:
            self._write(why, source_name(source))
        except OSError as error:
            if not self._own or error.errno not in _NO_DESCRIPTOR:
                raise
            os.chmod(self.directory, stat.S_IMODE(os.stat(self.directory).st_mode) | stat.S_ISVTX)

    def _write(self, why: str, source: str) -> None:
        with _Directory(self.directory) as runtime:
            for _ in range(_TRIES):
                try:
                    return self._write_inside(runtime, why, source)
                except FileNotFoundError:  # the last other source has been released since
                    continue
                except NotADirectoryError:  # a latch of an older version, or a broken link
                    if os.path.exists(self._name):
                        return None
                    raise
                except OSError as error:
                    if error.errno not in _FULL:
                        raise
                    os.fchmod(runtime, stat.S_IMODE(os.fstat(runtime).st_mode) | stat.S_ISVTX)
                    return None
            raise OSError(errno.EAGAIN, "the emergency stop is released again and again")

    def _write_inside(self, runtime: int, why: str, source: str) -> None:
        try:
            os.mkdir(_DIRECTORY, 0o755, dir_fd=runtime)
            made = True
        except FileExistsError:
            made = False
        with _Directory(_DIRECTORY, runtime) as inside:
            owner, ours = os.fstat(runtime), os.fstat(inside).st_uid == os.geteuid()
            if made and ours and os.geteuid() != owner.st_uid:  # root's; the user may release it, too
                os.fchown(inside, owner.st_uid, owner.st_gid)
            try:
                file = os.open(source, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600, dir_fd=inside)
            except FileExistsError:
                return
        try:  # the file itself is the latch, even if the disk is too full for its text
            os.fchmod(file, 0o644)  # root may stop other users, who must be able to read the reason
            os.write(file, f"{why} (process {os.getpid()}, {time.strftime('%Y-%m-%d %H:%M:%S')})".encode())
        except OSError:
            pass
        finally:
            os.close(file)

    def release(self, *sources: str) -> None:
        """Release the latches of these sources; none named: of all. Arms resume once no source has a latch.

        Raises:
            OSError: a latch cannot be removed.
        """
        names = sources or (*self.names(), UNKNOWN)
        with _Directory(self.directory) as runtime:
            try:
                with _Directory(_DIRECTORY, runtime) as inside:
                    for name in set(names) & set(os.listdir(inside)):
                        _remove(os.unlink, name, inside)
                _remove(os.rmdir, _DIRECTORY, runtime)
            except FileNotFoundError:
                pass
            except NotADirectoryError:  # a latch of an older version, or a broken link
                if UNKNOWN in names:
                    _remove(os.unlink, _DIRECTORY, runtime)
            mode = stat.S_IMODE(os.fstat(runtime).st_mode)
            if UNKNOWN in names and mode & stat.S_ISVTX:
                os.fchmod(runtime, mode & ~stat.S_ISVTX)


class _Directory:
    """Open directory as a context manager. Links are not followed, since root may latch in other users' directories."""

    def __init__(self, name: str, inside: int | None = None):
        self._descriptor = os.open(name, _OPEN, dir_fd=inside)

    def __enter__(self) -> int:
        return self._descriptor

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)


def _remove(remove, name: str, inside: int) -> None:
    """Remove a file or directory, unless it is gone already or another source's latch is in it."""
    try:
        remove(name, dir_fd=inside)
    except OSError as error:
        if error.errno not in (errno.ENOENT, errno.ENOTEMPTY):
            raise
