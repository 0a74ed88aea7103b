"""The vendor's USB-GPIO converter on a pseudo-terminal, after the frames that the maker documents."""

import contextlib
import fcntl
import os
import select
import struct
import termios
import threading
import tty


class Converter:
    """A converter of 16 channels; `port` is the path of its serial port.

    Attributes:
        inputs: channel → level. outputs: channel → level, as set.
        deaf: whether it answers nothing. mutes: number of the next requests that it does not answer.
        leaving: whether it is unplugged once its next reading has been taken.
    """

    def __init__(self):
        self._far, near = os.openpty()
        tty.setraw(near)
        self.port, self._near = os.ttyname(near), near
        self.inputs, self.outputs = {1: 0, 2: 0}, {}
        self.deaf, self.mutes, self.asked = False, 0, []
        self.leaving = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def restart(self):
        """Lose the outputs and send the frame of a start, as after a break of its supply."""
        self.outputs = {}
        os.write(self._far, b"\x2a\xff")

    def close(self):
        self._ended.set()
        self._thread.join()
        for end in (self._near, self._far):
            with contextlib.suppress(OSError):
                os.close(end)

    def _serve(self):
        heard = b""
        while not self._ended.is_set() and not self._gone():
            if not select.select([self._far], [], [], 0.02)[0]:
                continue
            heard += os.read(self._far, 64)
            while heard and len(heard) >= (size := {0x3A: 3, 0x3F: 2, 0x5B: 4}[heard[0]]):
                request, heard = heard[:size], heard[size:]
                self.asked.append(request)
                if self.deaf or self.mutes:
                    self.mutes = max(self.mutes - 1, 0)
                    continue
                os.write(self._far, self._answer(request))

    def _gone(self):
        """Leave between two readings: the far end closes while nobody reads the near one."""
        if not self.leaving or self.asked[-1:] != [b"\x5b\x01\x02\x00"]:
            return False
        while struct.unpack("i", fcntl.ioctl(self._near, termios.FIONREAD, bytes(4)))[0]:
            pass
        os.close(self._far)
        return True

    def _answer(self, request):
        if request[0] == 0x3A:
            self.outputs[request[1]] = request[2]
            return b"\x2a" + request[1:]
        if request[0] == 0x3F:
            return bytes((0x2F, request[1], self.inputs.get(request[1], 1)))
        first, last = request[1:3]
        return b"\x4b" + request[1:] + bytes(self.inputs.get(channel, 1) for channel in range(first, last + 1))
