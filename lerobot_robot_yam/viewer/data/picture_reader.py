"""Decodes the pictures that are to be seen, in a thread: what is asked last counts."""

import contextlib
import threading

import numpy as np

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.face.datasets.check.opened_dataset import OpenedDataset, RecordedEpisode
from lerobot_robot_yam.face.datasets.dataset_pictures import DatasetPictures

Wish = tuple[RecordedEpisode, int]
"""An episode and a frame of it."""


class PictureReader:
    """Reads all cameras of one frame at a time.

    Args:
        data: the data set.
    """

    def __init__(self, data: OpenedDataset):
        self._data = data
        self._wanted = threading.Condition()
        self._wish: Wish | None = None
        self._read: dict[str, np.ndarray | str] | None = None
        self._ending = False
        self._thread = threading.Thread(target=self._run, name="yam-view-pictures", daemon=True)
        self._thread.start()

    def ask(self, episode: RecordedEpisode, frame: int) -> None:
        """Read this frame next, and forget what was asked before."""
        with self._wanted:
            self._wish = episode, frame
            self._wanted.notify()

    def take(self) -> dict[str, np.ndarray | str] | None:
        """What was read since the last call, by camera: (height, width, 3) uint8, or why it is missing."""
        with self._wanted:
            read, self._read = self._read, None
        return read

    def _next(self) -> Wish | None:
        with self._wanted:
            self._wanted.wait_for(lambda: self._ending or self._wish is not None)
            wish, self._wish = self._wish, None
            return None if self._ending else wish

    def _run(self) -> None:
        with contextlib.closing(DatasetPictures(self._data)) as pictures:
            while (wish := self._next()) is not None:
                read: dict[str, np.ndarray | str] = {}
                for camera in self._data.cameras:
                    try:
                        read[camera] = pictures.picture(wish[0], camera, wish[1])
                    except YamError as error:
                        read[camera] = str(error)
                with self._wanted:
                    self._read = read

    def close(self) -> None:
        """End the thread. Idempotent."""
        with self._wanted:
            self._ending = True
            self._wanted.notify()
        self._thread.join()
