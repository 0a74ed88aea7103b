"""A terminal with a shell that runs one command, as a user has it: keys, signals, its mode before and after."""

import fcntl
import os
import pty
import select
import signal
import subprocess
import termios
import time
from pathlib import Path

from tests.support.waiting import wait

# The shell outlives the command and leaves the terminal's mode alone, unlike an interactive one.
_SHELL = 'trap : INT TERM HUP; stty $MODE; stty -a > "$1/before"; shown="$1"; shift; "$@"; echo $? > "$shown/rc"; \
sleep 1.2; stty -a > "$shown/after"'


class Terminal:
    """One command in a terminal of its own, which is in a mode for stty; what it prints goes to the terminal."""

    def __init__(self, directory, *command, cwd=None, env=None, mode="sane"):
        self.directory = Path(directory)
        self._master, slave = pty.openpty()
        self._shown = b""
        self.shell = subprocess.Popen(
            ["sh", "-c", _SHELL, "sh", str(self.directory), *map(str, command)],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            cwd=cwd,
            env=(os.environ if env is None else env) | {"MODE": mode},
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        os.close(slave)

    @property
    def shown(self):
        """All that was shown until now."""
        while select.select([self._master], [], [], 0.0)[0]:
            try:
                self._shown += os.read(self._master, 65536)
            except OSError:  # the shell has ended
                break
        return self._shown.decode(errors="replace")

    def type(self, keys):
        """Type keys."""
        os.write(self._master, keys)

    def wait_shown(self, text, timeout_s=60.0):
        """Wait until something is shown."""
        wait(lambda: text in self.shown, timeout_s, lambda: self.shown[-4000:], self.shell)

    def answer(self, *dialogue):
        """Wait for each text, and type the keys that go with it."""
        for text, keys in dialogue:
            self.wait_shown(text)
            self.type(keys)

    @property
    def echoes(self):
        """Whether the terminal shows what is typed, and waits for whole lines."""
        flags = termios.tcgetattr(self._master)[3]
        return bool(flags & termios.ECHO), bool(flags & termios.ICANON)

    @property
    def command(self):
        """Process number of the command."""
        deadline = time.monotonic() + 5.0
        while time.monotonic() < deadline:
            children = Path(f"/proc/{self.shell.pid}/task/{self.shell.pid}/children").read_text().split()
            if children:
                return int(children[0])
            time.sleep(0.01)
        raise AssertionError(self.shown)

    def kill(self, number):
        """Send the command a signal."""
        os.kill(self.command, number)

    def end(self, timeout_s=60.0):
        """Wait for its end; returns the command's exit status as the shell tells it."""
        deadline = time.monotonic() + timeout_s
        while self.shell.poll() is None:
            assert self.shown is not None and time.monotonic() < deadline, self.shown[-4000:]
            time.sleep(0.02)
        assert self.shown is not None
        return int((self.directory / "rc").read_text())

    def modes(self):
        """What `stty -a` has said before and after."""
        return [(self.directory / name).read_text() for name in ("before", "after")]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """End everything that still runs. Idempotent."""
        if self.shell.poll() is None:
            for pid in (self.command, self.shell.pid):
                os.kill(pid, signal.SIGKILL)
            self.shell.wait()
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
