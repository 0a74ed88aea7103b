"""How an episode was recorded: the times of its frames, and what else a training would not see in them."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

_LATE = 1.5  # of a frame's time
_SAMPLE = 16  # compared first: every sixteenth row and column
_SLOW = 0.95  # of the frames per second that the data set says


@dataclass
class EpisodeFigures:
    """Filled while the episode is recorded.

    Attributes:
        index: of the episode.
        fps: frames per second that the data set says.
        begun: date and time, ISO 8601 with the time zone.
        times_s: of each frame, monotonic.
        images: the newest of each camera.
        repeated: frames whose image of a camera was the one of the frame before.
        lost: replies that motors of all arms have not given since the episode began.
        held_back: frames in which an arm hurried behind its target at the speed limit.
        changed: actions that were not sent as they were given.
    """

    index: int
    fps: int
    begun: str
    times_s: list[float] = field(default_factory=list)
    images: dict[str, Any] = field(default_factory=dict)
    repeated: Counter[str] = field(default_factory=Counter)
    lost: int = 0
    held_back: int = 0
    changed: int = 0

    def add_frame(self, now_s: float, images: Mapping[str, Any], held_back: bool) -> None:
        """One observation of the episode."""
        self.times_s.append(now_s)
        self.repeated.update(name for name, image in images.items() if _same(self.images.get(name), image))
        self.images = dict(images)
        self.held_back += held_back

    @property
    def frames(self) -> int:
        """How many observations there were."""
        return len(self.times_s)

    @property
    def achieved_fps(self) -> float:
        """Frames per second as they really came; that of the data set where there are not two."""
        return (self.frames - 1) / (self.times_s[-1] - self.times_s[0]) if self.frames > 1 else float(self.fps)

    @property
    def late_frames(self) -> int:
        """How many came more than half a period late."""
        return int((np.diff(self.times_s) > _LATE / self.fps).sum())

    @property
    def slow(self) -> bool:
        """It is stamped faster than it was: whoever plays or learns it sees a world that hurries."""
        return self.achieved_fps < _SLOW * self.fps

    def summary(self) -> str:
        """One line: what a person wants to know before the next episode."""
        rate = f" at {self.achieved_fps:.1f} of {self.fps} fps" if self.frames > 1 else ""
        found = [f"{self.frames} frame{'s' * (self.frames != 1)}{rate}"]
        if self.late_frames:
            found.append(f"{self.late_frames} late (longest {np.diff(self.times_s).max() * 1e3:.0f} ms)")
        found += [f"{count} repeated images of {name}" for name, count in sorted(self.repeated.items())]
        if self.lost:
            found.append(f"{self.lost} lost replies of motors")
        if self.held_back:
            found.append(f"{self.held_back / self.frames:.0%} of frames at the speed limit")
        if self.changed:
            found.append(f"{self.changed} actions changed by limits")
        return f"episode {self.index}: {', '.join(found)}"

    def row(self) -> dict[str, Any]:
        """For the side-car: times in s since the first frame."""
        times = np.array(self.times_s) - (self.times_s[0] if self.times_s else 0.0)
        return {
            "episode_index": self.index,
            "begun": self.begun,
            "fps": self.fps,
            "achieved_fps": round(self.achieved_fps, 3),
            "frames": self.frames,
            "late_frames": self.late_frames,
            "repeated_images": dict(self.repeated),
            "lost_replies": self.lost,
            "frames_at_speed_limit": self.held_back,
            "changed_actions": self.changed,
            "times_s": np.round(times, 4).tolist(),
        }


def _same(before: Any, image: Any) -> bool:
    """Whether two images are equal. A sample decides where they are not, in microseconds."""
    if before is None or before.shape != image.shape:
        return False
    return np.array_equal(before[::_SAMPLE, ::_SAMPLE], image[::_SAMPLE, ::_SAMPLE]) and np.array_equal(before, image)
