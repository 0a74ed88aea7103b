"""For how long a disk holds what is recorded, at the rate at which it fills."""

from collections import deque

from lerobot_robot_yam.face.recorder.disk_guard import LEFT_FREE

_WINDOW_S = 300.0  # of recording
_LEAST_S = 5.0
_WARNED_S = 600.0


class DiskLeft:
    """Counts bytes from the beginnings of recordings on: in between LeRobot encodes images, and removes them."""

    def __init__(self) -> None:
        self._begun = deque[tuple[float, int]]()  # of each recording: seconds recorded until then, free bytes
        self._recorded_s = self._looked_s = 0.0
        self._records = False

    def left_s(self, now_s: float, free: int, recording: bool) -> float | None:
        """Seconds of recording until no more is free than `EpisodeLog` leaves; None: it does not fill, or not yet.

        Args:
            now_s: monotonic; ascends from call to call.
            free: bytes.
            recording: at the moment.
        """
        if recording and self._records:
            self._recorded_s += now_s - self._looked_s
        elif recording:
            self._begun.append((self._recorded_s, free))
            while len(self._begun) > 1 and self._recorded_s - self._begun[1][0] > _WINDOW_S:
                self._begun.popleft()
        self._looked_s, self._records = now_s, recording
        begun_s, before = self._begun[0] if self._begun else (0.0, free)
        if self._recorded_s - begun_s < _LEAST_S or free >= before:
            return None
        return max(free - LEFT_FREE, 0) * (self._recorded_s - begun_s) / (before - free)


def disk_warning(left_s: float | None, free: int) -> str:
    """What a person should know; empty: there is room."""
    if free < LEFT_FREE:
        return "the disk is full: the recording ends"
    if left_s is not None and left_s < _WARNED_S:
        return f"the disk is full in {left_s / 60.0:.1f} min of recording: make room, or end before"
    return ""
