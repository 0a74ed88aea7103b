"""Camera feed: a thread reads images and keeps the latest. A camera that fails is reopened when it is available."""

import logging
import threading
import time
from collections.abc import Callable

from lerobot_robot_yam.cameras.picture_source import Picture, PictureSource
from lerobot_robot_yam.errors import CameraError, StaleStateError, YamError

logger = logging.getLogger(__name__)

_RETRY_S = 0.05  # interval between attempts to reopen a failed camera, s
_JOIN_S = 2.0  # maximum wait for the reading thread to end, s


class CameraFeed:
    """Feed that reads a camera from `start` to `stop`.

    Args:
        name: name of the camera in messages.
        open_source: finds and opens the camera; raises a YamError on failure.
        finish: converts each image for the caller; runs in the reading thread.

    Attributes:
        number: number of images so far.
    """

    def __init__(self, name: str, open_source: Callable[[], PictureSource], finish: Callable[[Picture], Picture]):
        self._name, self._open, self._finish = name, open_source, finish
        self._news = threading.Condition()
        self._picture: Picture | None = None
        self.number = 0
        self._trouble = ""
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def running(self) -> bool:
        return self._thread is not None

    def start(self) -> None:
        """Open the camera and wait for the first image. Raises YamError: see `open_source` and the camera."""
        source = self._opened()
        self._ended.clear()
        self._thread = threading.Thread(target=self._run, args=(source,), name=f"camera {self._name}", daemon=True)
        self._thread.start()

    def latest(self, max_age_s: float) -> Picture:
        """Return the latest image without waiting.

        Raises:
            StaleStateError: the image is older than max_age_s; the message contains the fault of the camera.
        """
        picture = self._picture
        assert picture is not None, "start() has published one"
        age_s = time.monotonic() - picture.stamp_s
        if age_s > max_age_s:
            raise self._stale(f"newest picture is {age_s * 1e3:.0f} ms old, more than {max_age_s * 1e3:.0f} ms")
        return picture

    def wait_new(self, after: int, timeout_s: float) -> tuple[Picture, int]:
        """Wait for an image after number `after`; return the latest image and its number.

        Raises:
            StaleStateError: no image arrives within timeout_s.
        """
        with self._news:
            if not self._news.wait_for(lambda: self.number > after, timeout_s):
                raise self._stale(f"no new picture within {timeout_s * 1e3:.0f} ms")
            assert self._picture is not None
            return self._picture, self.number

    def stop(self) -> None:
        """Release the camera. Idempotent."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._ended.set()
        thread.join(_JOIN_S)
        if thread.is_alive():
            logger.warning("%s: is still waiting for a picture; it is released when one comes", self._name)

    def _run(self, source: PictureSource) -> None:
        """Read the camera until the feed is stopped. If the camera fails, retry opening it until that succeeds."""
        while True:
            try:
                while not self._ended.is_set():
                    self._publish(source.read())
                return
            except CameraError as error:
                self._trouble, since_s = f"{error}; it is waited for", time.monotonic()
                logger.warning("%s: %s", self._name, self._trouble)
            finally:
                source.close()
            while self._trouble:
                if self._ended.wait(_RETRY_S):
                    return
                try:
                    source, self._trouble = self._opened(), ""
                except YamError as error:
                    self._trouble = f"{error}; it is waited for"
            logger.warning("%s: is back after %.2f s", self._name, time.monotonic() - since_s)

    def _opened(self) -> PictureSource:
        """Open the camera, and publish the first image."""
        source = self._open()
        try:
            self._publish(source.read())
        except BaseException:
            source.close()
            raise
        return source

    def _publish(self, picture: Picture) -> None:
        finished = self._finish(picture)
        with self._news:
            self._picture = finished
            self.number += 1
            self._news.notify_all()

    def _stale(self, what: str) -> StaleStateError:
        return StaleStateError(
            f"{self._name}: {what}; " + (self._trouble or "the camera, its USB bus or this machine is too slow")
        )
