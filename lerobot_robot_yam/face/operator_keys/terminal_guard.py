"""A program of its own: gives a terminal its mode back when the process that has changed it is gone, however it went.

python -I -S terminal_guard.py DESCRIPTOR PARENT < pipe

Standard input comes from that process and ends with it. Each line is a pair: the mode to give back, and the mode that
the process has set. Nothing happens if the terminal is in another mode by then: somebody else has set that.
"""

import ast
import contextlib
import os
import select
import sys
import termios

_LOOK_S = 0.25  # a child of the process may keep the pipe open


def main(terminal: int, parent: int) -> None:
    """Wait for the end of `parent`, then restore the terminal with this descriptor."""
    told = b""
    while True:
        if select.select([0], [], [], _LOOK_S)[0]:
            piece = os.read(0, 65536)
            if not piece:
                break
            told += piece
        elif os.getppid() != parent:
            break
    lines = told.decode().splitlines()
    if lines:
        restore(terminal, *ast.literal_eval(lines[-1]))


def restore(terminal: int, mode: list, ours: list) -> None:
    """Set a terminal's mode if it has the mode `ours`; one that is gone is left alone."""
    with contextlib.suppress(termios.error, OSError):
        if termios.tcgetattr(terminal) == ours:
            termios.tcsetattr(terminal, termios.TCSANOW, mode)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
