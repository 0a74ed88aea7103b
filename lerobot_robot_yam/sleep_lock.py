"""Keep the computer awake while it drives arms: asleep it commands no motor, and 0.4 s later they let go.

A desktop counts keys and mouse only: to it nobody is there while leader arms are moved by hand. systemd's log-in
manager grants a lock for as long as a command runs (`systemd-inhibit`); ours waits for the end of its input, which
comes with ours however we end.
"""

import contextlib
import logging
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

logger = logging.getLogger(__name__)

SLEEP = "sleep"
STATES = Path("/sys/power/state")  # what the kernel can do, such as "freeze mem disk"; a virtual machine often nothing
SUSPEND = Path("/etc/systemd/system/suspend.target")
SWITCH_OFF = "switch it off for good: sudo systemctl mask sleep.target suspend.target hibernate.target"

# The next where one is refused: who has logged in from elsewhere is granted little.
_WISHES = f"{SLEEP}:idle:handle-lid-switch {SLEEP}:idle idle"
_HOLD = (
    f"for what in {_WISHES}; do systemd-inhibit --what=$what --mode=block --who=YAM --why='arms are driven' "
    'sh -c "echo $what; exec cat" && exit; done; echo'
)
_END_S = 1.0


def can_sleep() -> bool:
    """Whether this computer can be suspended at all."""
    try:
        states = STATES.read_text().split()
    except OSError:
        return False
    return bool(states) and SUSPEND.resolve() != Path("/dev/null")  # masked


class SleepLock:
    """Asks for the lock; `granted` waits for the answer."""

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

    def granted(self) -> str:
        """What is kept from happening, such as "sleep:idle"; empty when nothing is."""
        return self._answer.readline().decode().strip()

    def release(self) -> None:
        """Let the computer sleep again."""
        self._end.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._holder.wait(_END_S)


@contextlib.contextmanager
def kept_awake(arms: str) -> Iterator[None]:
    """Hold the lock where the computer can sleep, and log what is granted. `arms`: for the log.

    Does not wait for the answer.
    """
    if not can_sleep():
        yield
        return
    lock = SleepLock()

    def tell() -> None:
        granted = lock.granted()
        if SLEEP in granted:
            logger.info("%s: this computer is kept awake (%s)", arms, granted)
        else:
            logger.warning(
                "%s: nothing keeps this computer from going to sleep, and then the arms fall; %s", arms, SWITCH_OFF
            )

    told = threading.Thread(target=tell, name="yam-awake", daemon=True)
    told.start()
    try:
        yield
    finally:
        lock.release()
        told.join(_END_S)
