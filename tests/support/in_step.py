"""Devices of one process on a rig in lock-step: while one of them waits, the control loops of all tick."""

from typing import ClassVar

from lerobot_robot_yam.session.runners import StepRunner


class Together(StepRunner):
    """What `isolation` of each of these devices is: a loop that ticks whenever another one does."""

    _running: ClassVar[list["Together"]] = []

    @property
    def _ticks(self):
        return self._all

    @_ticks.setter
    def _ticks(self, own):
        self._own, self._all = own, self._with_others(own)

    def _with_others(self, own):
        for _ in own:
            for other in self._running:
                if other is not self:
                    next(other._own, None)
            yield

    def start(self, blocks):
        super().start(blocks)
        self._running.append(self)

    def discard(self):
        if self in self._running:
            self._running.remove(self)
        super().discard()
