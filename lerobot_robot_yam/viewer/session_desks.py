"""Session desks of the page: one for each LeRobot command that drives our arms on this computer, found automatically.

Each desk is a folder with the command's progress, its success count, and buttons for the actions offered at present.
"""

import html
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import viser
from viser._messages import HotkeyKey, KeyModifier

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.recorder import outcomes
from lerobot_robot_yam.state.desk_post import Asked, ask, forget_the_dead, running_desks
from lerobot_robot_yam.system.runtime_files import runtime_dir

BY = "yam-view"
MODIFIER: KeyModifier = "shift"  # modifier of all hotkeys: viser's camera uses W, A, S, D, Q and E without a modifier
# Meaning of a button → label, colour and hotkey.
BUTTONS: dict[str, tuple[str, tuple[int, int, int] | None, HotkeyKey]] = {
    "success": ("success", (30, 150, 60), "S"),
    "failure": ("failure", (200, 110, 0), "F"),
    "discard": ("discard", (110, 110, 110), "D"),
    "next": ("next", None, "N"),
    "rerecord": ("again", None, "R"),
    "stop": ("stop", (190, 40, 40), "Q"),
    "pause": ("pause", None, "P"),
    "correct": ("correct", None, "C"),
    "go_on": ("go on", None, "G"),
    "save": ("save", None, "K"),
}
_BANNER = "background:#c00;color:#fff;padding:0.5em;font-weight:bold"
_SILENT_S = 3.0  # status age above which the page warns, s: LeRobot may block Python while saving
_DAY_S = 86_400.0
_LOOK_S = 0.25


class SuccessRate:
    """Count of successful episodes in a data set, from its labels file, which is read again after each change.

    `root`: folder of the data set; `first`: number of episodes recorded before this session, which are not counted.
    """

    def __init__(self, root: Path, first: int):
        self._path, self._root, self._first = root / outcomes.OUTCOMES, root, first
        self._seen: tuple[int, int] | None = None
        self._labels: dict[int, str | None] = {}

    def words(self, saved: int) -> str:
        """Return a line about successes. `saved`: number of saved episodes in the data set, with and without labels."""
        self._read()
        labels = [label for episode, label in self._labels.items() if self._first <= episode < saved]
        count = {kind: labels.count(kind) for kind in outcomes.KINDS}
        judged = count[outcomes.SUCCESS] + count[outcomes.FAILURE]
        share = f" ({count[outcomes.SUCCESS] / judged:.0%})" if judged else ""
        found = [f"success {count[outcomes.SUCCESS]} of {judged}{share}"]
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
            self._seen = None  # the file is incomplete: keep the last labels and retry


class DeskFolder:
    """Folder of one LeRobot command on the page.

    Args:
        gui: the server's gui.
        number: process id of the command.
        send: callback that sends a request; viser's threads call it.
    """

    def __init__(self, gui: viser.GuiApi, number: int, send: Callable[[Asked], None]):
        self._folder = gui.add_folder(f"session {number}")
        self.status: dict[str, Any] = {"offers": {}}
        self._rate: SuccessRate | None = None
        self._buttons: dict[str, viser.GuiButtonHandle] = {}
        self._send = send
        with self._folder:
            self._text = gui.add_html("")
            for meaning, (label, colour, key) in BUTTONS.items():
                button = gui.add_button(f"{label} [{key_name(key)}]", color=colour, visible=False)
                button.on_click(partial(self._clicked, meaning))
                self._buttons[meaning] = button

    def _clicked(self, meaning: str, _: viser.GuiEvent) -> None:
        self.press(meaning)

    def press(self, meaning: str) -> None:
        """Send the request of a button, if the command offers that request in the phase shown on the page."""
        status = self.status
        if meaning in status["offers"]:
            self._send(Asked(meaning, BY, status.get("turn")))

    def show(self, status: dict[str, Any]) -> None:
        """Show a new status, or an error message if the status has an unknown format."""
        try:
            if "root" in status and self._rate is None:
                self._rate = SuccessRate(Path(status["root"]), status.get("first", 0))
            content, offered = describe(status, self._rate), dict(status.get("offers", {}))
        except (TypeError, ValueError, AttributeError, LookupError) as error:
            content, offered = f"its status is not understood: {html.escape(repr(error))}", {}
        self.status = {**status, "offers": offered}
        for meaning, button in self._buttons.items():
            if button.visible != (meaning in offered):
                button.visible = meaning in offered
        if content != self._text.content:
            self._text.content = content

    def close(self) -> None:
        """Remove the folder from the page."""
        self._folder.remove()


def key_name(key: HotkeyKey) -> str:
    """Return the name of a hotkey including its modifier, such as "Shift+S"."""
    return f"{MODIFIER.capitalize()}+{key}"


def describe(status: dict[str, Any], rate: SuccessRate | None) -> str:
    """Return the folder's HTML. `rate`: success counter of the data set; None: show no line about successes."""
    red = [status["disk_warning"]] if "disk_warning" in status else []
    if status["age_s"] > _SILENT_S:
        red.append(f"has said nothing for {status['age_s']:.0f} s")
    lines = [f"<div style='{_BANNER}'>{html.escape(line)}</div>" for line in red]
    lines += [html.escape(line) for line in (*_doing(status), *_rates(status)) if line]
    if rate is not None and "saved" in status:
        lines.append(html.escape(rate.words(status["saved"])))
    offers = status.get("offers", {})
    told = [(key_name(BUTTONS[name][2]), words) for name, words in offers.items() if name in BUTTONS]
    lines += [f"<b>{key}</b>: {html.escape(words)}" for key, words in told]
    return f"<div style='padding:0 0.8em;font-size:13px'>{'<br>'.join(lines)}</div>"


def _doing(status: dict[str, Any]) -> list[str]:
    """Return lines about the command, its task, the episode with its phase, and the times."""
    what = " ".join(status[name] for name in ("command", "strategy") if name in status)
    lines = [what, status.get("task", "")]
    saved, first = status.get("saved"), status.get("first", 0)
    episode = "" if saved is None else f"episode {saved}"
    if saved is not None and "episodes" in status:
        episode += f" ({min(saved - first + 1, status['episodes'])} of {status['episodes']})"
    dropped = ", the episode is dropped" if "drops" in status else ""
    lines.append(f"{episode}{': ' * bool(episode)}{status.get('phase', '')}{dropped}")
    times = [f"{status['elapsed_s']:.0f} s"] if "elapsed_s" in status else []
    times += [f"{status['left_s']:.0f} s left"] if "left_s" in status else []
    return [*lines, ", ".join(times)]


def _rates(status: dict[str, Any]) -> list[str]:
    """Return lines about the loop rate, the encoder, the disk, and the success count kept by LeRobot itself."""
    loop = [f"{status['fps']:.1f} of {status['fps_asked']:.0f} fps"] if "fps" in status else []
    loop += [f"{status['late']} late"] if status.get("late") else []
    waiting = status.get("encoder_waiting", {})
    encoder = ", ".join(f"{name.rpartition('.')[2]} {count}" for name, count in waiting.items())
    if encoder:
        encoder = f"encoder waits with {encoder} of {status.get('encoder_room', '?')} frames"
    lost = ", ".join(f"{count} of {name.rpartition('.')[2]}" for name, count in status.get("encoder_lost", {}).items())
    images = f"{status['images_waiting']} images wait to be written" if "images_waiting" in status else ""
    disk = [f"{status['disk_free_bytes'] / 1e9:.1f} GB free"] if "disk_free_bytes" in status else []
    if status.get("disk_left_s", _DAY_S) < _DAY_S:
        disk.append(f"for {status['disk_left_s'] / 60.0:.0f} min of recording")
    counted = f"success {status['successes']} of {status['saved']}" if "successes" in status else ""
    return [", ".join(loop), encoder, f"FRAMES LOST: {lost}" if lost else "", images, ", ".join(disk), counted]


class SessionDesks:
    """Desks of all LeRobot commands that run."""

    def __init__(self, server: viser.ViserServer):
        self._gui = server.gui
        self._folders: dict[int, DeskFolder] = {}
        self._wishes = deque[tuple[int, Asked]]()  # requests queued by viser's threads: (process id, request)
        self._keys = deque[str]()
        self._looked_s = -_LOOK_S
        forget_the_dead(runtime_dir())
        self._commands = [self._on_key(meaning, label, key) for meaning, (label, _, key) in BUTTONS.items()]

    def _on_key(self, meaning: str, label: str, key: HotkeyKey) -> viser.CommandHandle:
        command = self._gui.add_command(f"session: {label}", hotkey=key, modifier=MODIFIER)
        command.on_trigger(lambda _: self.press(meaning))
        return command

    def press(self, meaning: str) -> None:
        """Queue a pressed hotkey, given by its meaning, for the next `update`. Any thread may call this."""
        self._keys.append(meaning)

    def update(self, now_s: float) -> None:
        """Send the queued requests, and show the newest status of each command."""
        while self._keys:
            meaning = self._keys.popleft()
            if len(self._folders) == 1:  # a hotkey is ambiguous with several commands, and is then ignored
                next(iter(self._folders.values())).press(meaning)
        while self._wishes:
            number, asked = self._wishes[0]
            if number in self._folders and not ask(runtime_dir(), number, asked):
                break  # the command's mailbox is full: retry in the next update
            self._wishes.popleft()
        if now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            self._look()

    def _look(self) -> None:
        running = running_desks(runtime_dir())
        for number in self._folders.keys() - running.keys():
            self._folders.pop(number).close()
        for number, status in running.items():
            if number not in self._folders:
                self._folders[number] = DeskFolder(self._gui, number, partial(self._note, number))
            self._folders[number].show(status)

    def _note(self, number: int, asked: Asked) -> None:
        self._wishes.append((number, asked))

    def close(self) -> None:
        """Remove all folders and hotkeys. Idempotent."""
        for command in self._commands:
            command.remove()
        self._commands.clear()
        for folder in self._folders.values():
            folder.close()
        self._folders.clear()
