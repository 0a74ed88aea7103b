"""Keep the computer awake while it drives arms: asleep it commands no motor, and 0.4 s later they let go.

A desktop counts keys and mouse only, so it finds no user while leader arms are moved by hand. systemd's log-in
manager grants a lock for as long as a command runs (`systemd-inhibit`); ours waits for the end of its input, which
comes with ours however we end. The log says whether that is enough: a user who has logged in from elsewhere is granted
less, and before systemd 257 a desktop may suspend in spite of its user's lock.
"""

import contextlib
import logging
import os
import select
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

logger = logging.getLogger(__name__)

STATES = Path("/sys/power/state")  # what the kernel can do, such as "freeze mem disk"; a virtual machine often nothing
SUSPEND = Path("/etc/systemd/system/suspend.target")
SWITCH_OFF = "switch it off for good: sudo systemctl mask sleep.target suspend.target hibernate.target"

_ALL = "sleep:idle:handle-lid-switch"
_WISHES = (_ALL, "sleep:idle", "idle")  # the next where one is refused
_BINDING_SINCE = 257  # systemd's version: https://github.com/systemd/systemd/pull/30307
_HOLD = f"""
set -- $(systemd-inhibit --version)
export version="$2" what
for what in {" ".join(_WISHES)}; do
    systemd-inhibit --what=$what --mode=block --who=YAM --why="arms are driven" \\
        sh -c 'echo "$what $version"; exec cat' && exit
done
echo
"""
_ANSWER_S = 5.0
_END_S = 1.0


def can_sleep() -> bool:
    """Whether this computer can be suspended at all."""
    try:
        states = STATES.read_text().split()
    except OSError:
        return False
    return bool(states) and SUSPEND.resolve() != Path("/dev/null")  # masked


class SleepLock:
    """Asks for the lock; `granted` waits for the answer. Raises OSError: no process can be started."""

    def __init__(self) -> None:
        self._holder = subprocess.Popen(
            ["sh", "-c", _HOLD],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is not for it
        )
        assert self._holder.stdin is not None and self._holder.stdout is not None
        self._end, self._answer = self._holder.stdin, self._holder.stdout

    def granted(self) -> tuple[str, bool]:
        """Events that the lock prevents, such as "sleep:idle", or ""; and whether that is enough.

        Waits for 5 s at most.
        """
        answered = select.poll()  # which takes descriptors above 1023, too
        answered.register(self._answer, select.POLLIN)
        if not answered.poll(_ANSWER_S * 1e3):
            return "", False
        what, _, version = self._answer.readline().decode().strip().partition(" ")
        return what, what == _ALL and version.isdigit() and int(version) >= _BINDING_SINCE

    def release(self) -> None:
        """Let the computer sleep again."""
        self._end.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._holder.wait(_END_S)
            return
        # It hangs, or a process that was forked off ours holds the other end of its input.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._holder.pid, signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._holder.wait(_END_S)


@contextlib.contextmanager
def kept_awake(arms: str, quiet: bool = False) -> Iterator[None]:
    """Hold the lock where the computer can sleep, and log what is granted.

    Does not wait for the answer and raises nothing: the arms have to be driven, or landed, all the same.

    Args:
        arms: for the log.
        quiet: another process logs it.
    """
    if not can_sleep():
        yield
        return
    try:
        lock = SleepLock()
    except OSError as error:  # no memory for another process
        logger.error("%s: nothing keeps this computer from going to sleep: %s", arms, error)
        yield
        return

    def tell() -> None:
        what, enough = lock.granted()
        if enough:
            logger.info("%s: this computer is kept awake (%s)", arms, what)
        else:
            how = f"what its systemd grants ({what}) may not be enough" if what else "its systemd grants no lock"
            logger.warning("%s: this computer may go to sleep, and then the arms fall: %s; %s", arms, how, SWITCH_OFF)

    told = threading.Thread(target=tell, name="yam-awake", daemon=True)
    with contextlib.suppress(RuntimeError):  # nor for another thread
        if not quiet:
            told.start()
    try:
        yield
    finally:
        lock.release()
        if told.ident is not None:
            told.join(_END_S)
