"""How many of a data set's episodes were successes, as their labels say; read anew when these have changed."""

from pathlib import Path

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.recorder import outcomes


class SuccessRate:
    """Of one data set.

    Args:
        root: its folder.
        first: episodes that were there before this session; all count from it.
    """

    def __init__(self, root: Path, first: int):
        self._path, self._root, self._first = root / outcomes.OUTCOMES, root, first
        self._seen: tuple[int, int] | None = None
        self._labels: dict[int, str | None] = {}

    def words(self, saved: int) -> str:
        """One line. `saved`: episodes of the data set, of which some have no label."""
        self._read()
        labels = [label for episode, label in self._labels.items() if self._first <= episode < saved]
        count = {kind: labels.count(kind) for kind in outcomes.KINDS}
        judged = count[outcomes.SUCCESS] + count[outcomes.FAILURE]
        found = [f"success {count[outcomes.SUCCESS]} of {judged}" + (_share(count, judged))]
        if count[outcomes.DISCARD]:
            found.append(f"{count[outcomes.DISCARD]} to discard")
        if without := saved - self._first - len(labels):
            found.append(f"{without} without a label")
        return ", ".join(found)

    def _read(self) -> None:
        try:
            about = self._path.stat()
            seen = about.st_mtime_ns, about.st_size
            if seen != self._seen:
                self._labels = {episode: row.outcome for episode, row in outcomes.read(self._root).items()}
                self._seen = seen
        except FileNotFoundError:
            self._labels = {}
        except (OSError, ConfigError):
            self._seen = None  # half written; what was read before stays


def _share(count: dict[str, int], judged: int) -> str:
    return f" ({count[outcomes.SUCCESS] / judged:.0%})" if judged else ""
