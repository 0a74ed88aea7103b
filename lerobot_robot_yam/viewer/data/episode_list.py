"""Episode table (length, outcome, check flags), and the background thread that runs the check."""

import html
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import viser

from lerobot_robot_yam.face.datasets.check.dataset_report import DatasetReport, EpisodeReport, check_into
from lerobot_robot_yam.face.datasets.check.flags import Flag
from lerobot_robot_yam.face.datasets.check.opened_dataset import OpenedDataset, RecordedEpisode
from lerobot_robot_yam.viewer.serving.handles import put

_SHOWN_S = 0.5
_ALL, _FLAGGED = "all", "flagged"
_FILTERS = (_ALL, _FLAGGED, "success", "failure", "discard", "no label")
_STYLE = "font-family:monospace;font-size:11px;width:100%;border-collapse:collapse"
_BOX = "max-height:16em;overflow:auto;margin:0 0.8em"
_CHOSEN = "background:#f78b2e55"


class BackgroundCheck:
    """Background check of a data set, one picture per second of recording as in `yam-dataset-check`. The report grows.

    `arm`: profile with the joint limits; None: the widest limits of all arms.

    Attributes:
        report: findings so far.
        trouble: error that ended the check early; empty if there was none.
    """

    def __init__(self, data: OpenedDataset, arm: str | None = None):
        self.report = DatasetReport(data.root, data.fps, [], [])
        self.trouble = ""
        self._all, self._looked, self._ending = len(data.episodes), 0, False
        self._thread = threading.Thread(target=self._run, args=(data, arm), name="yam-view-check", daemon=True)

    def start(self) -> None:
        """Start the check. Call this once."""
        self._thread.start()

    @property
    def share(self) -> float:
        """Fraction of the episodes checked, 0 … 1."""
        return self._looked / self._all if self._all else 1.0

    @property
    def done(self) -> bool:
        """Whether the check has ended."""
        return self._thread.ident is not None and not self._thread.is_alive()

    def found(self) -> dict[int, EpisodeReport]:
        """Return episode number → report for the episodes checked so far."""
        return {episode.number: episode for episode in self.report.episodes[: self._looked]}

    def _run(self, data: OpenedDataset, arm: str | None) -> None:
        try:
            check_into(self.report, data, arm=arm, progress=self._watched)
        except Exception as error:  # a damaged data set may raise any error; the page still shows the rest
            self.trouble = f"{type(error).__name__}: {error}"

    def _watched(self, episodes: Iterable[Any]) -> Iterator[Any]:
        for episode in episodes:
            if self._ending:
                return
            yield episode
            self._looked += 1

    def close(self) -> None:
        """Stop the check after the current episode. Idempotent."""
        self._ending = True
        if self._thread.ident is not None:
            self._thread.join()


class EpisodeList:
    """Episode table that is filled while the check runs.

    Args:
        gui: the server's gui; the table is added to its open container.
        data: the data set.
        labels: episode number → outcome, for labelled episodes.
        check: the check whose findings are shown.
    """

    def __init__(self, gui: viser.GuiApi, data: OpenedDataset, labels: Mapping[int, str], check: BackgroundCheck):
        self._data, self._labels, self._check = data, labels, check
        seconds = sum(episode.length for episode in data.episodes) / data.fps
        gui.add_html(
            f"<div style='padding:0 0.8em'><b>{html.escape(str(data.root))}</b><br>{len(data.episodes)} episodes, "
            f"{seconds / 60:.1f} min at {data.fps:g} fps, {html.escape(str(data.info.get('robot_type') or ''))}</div>"
        )
        self._bar = gui.add_progress_bar(0.0)
        self._said = gui.add_html("")
        self._filter = gui.add_dropdown("show", _FILTERS)
        self._table = gui.add_html("")
        self._shown_s = -_SHOWN_S
        self._done = False

    def update(self, now_s: float, chosen: int) -> None:
        """Show the current findings. `chosen`: number of the episode on display."""
        if now_s - self._shown_s < _SHOWN_S:
            return
        self._shown_s = now_s
        found = self._check.found()
        if not self._done:
            self._done = self._check.done
            put(self._bar, value=round(100.0 * self._check.share), visible=not self._done)
            put(self._said, content=self._saying(found))
        rows = [
            _row(episode, self._data.fps, self._labels.get(episode.number, ""), found.get(episode.number), chosen)
            for episode in self._data.episodes
            if self._is_wanted(episode, found.get(episode.number))
        ]
        head = "<tr><th>episode<th>s<th>outcome<th>flags<th style='text-align:left'>task</tr>"
        put(self._table, content=f"<div style='{_BOX}'><table style='{_STYLE}'>{head}{''.join(rows)}</table></div>")

    def _is_wanted(self, episode: RecordedEpisode, report: EpisodeReport | None) -> bool:
        wanted, label = self._filter.value, self._labels.get(episode.number, "no label")
        return wanted in (_ALL, label) or (wanted == _FLAGGED and report is not None and bool(report.flags))

    def _saying(self, found: Mapping[int, EpisodeReport]) -> str:
        if self._check.trouble:
            text = f"the check has ended: {self._check.trouble}"
        elif not self._done:
            text = f"checking: {len(found)} of {len(self._data.episodes)} episodes"
        else:
            flagged = sum(bool(report.flags) for report in found.values())
            text = f"checked: {flagged} of {len(found)} episodes have flags"
        lines = [text, *(f"{flag.kind}: {flag.text}" for flag in self._check.report.flags)]
        return f"<div style='padding:0 0.8em'>{'<br>'.join(map(html.escape, lines))}</div>"


def _row(episode: RecordedEpisode, fps: float, label: str, report: EpisodeReport | None, chosen: int) -> str:
    flags = "…" if report is None else ", ".join(sorted({str(flag.kind) for flag in report.flags})) or "–"
    task = str((episode.metadata.get("tasks") or [""])[0])
    cells = [str(episode.number), f"{episode.length / fps:.1f}", label, flags]
    style = f" style='{_CHOSEN}'" if episode.number == chosen else ""
    text = "".join(f"<td style='text-align:right;padding-right:0.8em'>{html.escape(cell)}" for cell in cells)
    return f"<tr{style}>{text}<td>{html.escape(task[:40])}</tr>"


def describe(flags: Sequence[Flag] | None) -> str:
    """Return HTML about one episode's flags. `flags`: None if the episode has not been checked yet."""
    if flags is None:
        lines = ["not checked yet"]
    else:
        lines = [_line(flag) for flag in flags] or ["nothing was found"]
    return f"<div style='padding:0 0.8em;font-size:12px'>{'<br>'.join(lines)}</div>"


def _line(flag: Flag) -> str:
    where = "" if flag.frames is None else f" (frames {flag.frames[0]}–{flag.frames[1]})"
    text = f"<b style='color:#c00'>{flag.kind}</b>: {html.escape(flag.text + where)}"
    return f"<span title='{html.escape(f'{flag.kind.meaning}: {flag.kind.remedy}', quote=True)}'>{text}</span>"
