"""The check of a data set beside the page: a thread, whose report grows while it is shown."""

import threading
from collections.abc import Iterable, Iterator
from typing import Any

from lerobot_robot_yam.face.datasets.check.dataset_report import DatasetReport, EpisodeReport, check_into
from lerobot_robot_yam.face.datasets.check.opened_dataset import OpenedDataset


class BackgroundCheck:
    """Looks at one picture per second of each camera, as `yam-dataset-check` does.

    Args:
        data: the data set.
        arm: profile with the joint limits; None: the widest of all arms.

    Attributes:
        report: what was found so far.
        trouble: why the check has ended early; empty if it has not.
    """

    def __init__(self, data: OpenedDataset, arm: str | None = None):
        self.report = DatasetReport(data.root, data.fps, [], [])
        self.trouble = ""
        self._all, self._looked, self._ending = len(data.episodes), 0, False
        self._thread = threading.Thread(target=self._run, args=(data, arm), name="yam-view-check", daemon=True)

    def start(self) -> None:
        """Begin; once."""
        self._thread.start()

    @property
    def share(self) -> float:
        """How much of it is done, 0 … 1."""
        return self._looked / self._all if self._all else 1.0

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self._thread.ident is not None and not self._thread.is_alive()

    def found(self) -> dict[int, EpisodeReport]:
        """Reports by number of the episodes that were looked at."""
        return {episode.number: episode for episode in self.report.episodes[: self._looked]}

    def _run(self, data: OpenedDataset, arm: str | None) -> None:
        try:
            check_into(self.report, data, arm=arm, progress=self._watched)
        except Exception as error:  # a damaged data set may raise anything; the page is to be of use for it still
            self.trouble = f"{type(error).__name__}: {error}"

    def _watched(self, episodes: Iterable[Any]) -> Iterator[Any]:
        for episode in episodes:
            if self._ending:
                return
            yield episode
            self._looked += 1

    def close(self) -> None:
        """End it after the present episode. Idempotent."""
        self._ending = True
        if self._thread.ident is not None:
            self._thread.join()
