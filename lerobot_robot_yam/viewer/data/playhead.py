"""Where in an episode one looks, while it plays or stands."""


class Playhead:
    """A place that moves with time. Times are those of the caller's clock, in s.

    Attributes:
        frames: of the episode; at least 1.
        fps: frames per second, at speed 1.
        speed: factor.
        playing: whether it moves; it stops at the last frame.
    """

    def __init__(self, fps: float):
        self.fps, self.speed, self.frames, self.playing = fps, 1.0, 1, False
        self._place = 0.0  # in frames
        self._then_s: float | None = None

    @property
    def frame(self) -> int:
        """The frame to show."""
        return min(int(self._place), self.frames - 1)

    def open(self, frames: int) -> None:
        """Begin another episode."""
        self.frames, self.playing, self._place = max(frames, 1), False, 0.0

    def seek(self, frame: int) -> None:
        """Go to a frame, or as near as there is one."""
        self._place = float(min(max(frame, 0), self.frames - 1))

    def play(self) -> None:
        """Move on, from the start if it stands at the end."""
        if self.frame == self.frames - 1:
            self._place = 0.0
        self.playing, self._then_s = True, None

    def pause(self) -> None:
        """Stand."""
        self.playing = False

    def advance(self, now_s: float) -> int:
        """The frame to show at this time."""
        if self.playing:
            if self._then_s is not None:
                self._place += (now_s - self._then_s) * self.fps * self.speed
            if self._place >= self.frames - 1:
                self.seek(self.frames - 1)
                self.playing = False
        self._then_s = now_s
        return self.frame
