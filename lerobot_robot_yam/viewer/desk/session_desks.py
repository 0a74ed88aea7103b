"""The session desk of the page: every LeRobot command on this computer that drives our arms, found by itself."""

from collections import deque
from functools import partial

import viser
from viser._messages import HotkeyKey

from lerobot_robot_yam.state.desk_post import Asked, ask, forget_the_dead, running_desks
from lerobot_robot_yam.system.runtime_files import runtime_dir
from lerobot_robot_yam.viewer.desk.desk_folder import BUTTONS, MODIFIER, DeskFolder

_LOOK_S = 0.25


class SessionDesks:
    """A folder for each.

    Args:
        server: viser's.
    """

    def __init__(self, server: viser.ViserServer):
        self._gui = server.gui
        self._folders: dict[int, DeskFolder] = {}
        self._wishes = deque[tuple[int, Asked]]()  # of viser's threads
        self._keys = deque[str]()
        self._looked_s = -_LOOK_S
        forget_the_dead(runtime_dir())
        self._commands = [self._on_key(meaning, label, key) for meaning, (label, _, key) in BUTTONS.items()]

    def _on_key(self, meaning: str, label: str, key: HotkeyKey) -> viser.CommandHandle:
        command = self._gui.add_command(f"session: {label}", hotkey=key, modifier=MODIFIER)
        command.on_trigger(lambda _: self.press(meaning))
        return command

    def press(self, meaning: str) -> None:
        """As the key of this meaning. Any thread may call it; `update` does it."""
        self._keys.append(meaning)

    def update(self, now_s: float) -> None:
        """Pass on what was asked, and look for what has changed."""
        while self._keys:
            meaning = self._keys.popleft()
            if len(self._folders) == 1:  # else nobody knows which is meant: there are buttons
                next(iter(self._folders.values())).press(meaning)
        while self._wishes:
            number, asked = self._wishes[0]
            if number in self._folders and not ask(runtime_dir(), number, asked):
                break  # it is flooded: once more the next time
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
        """Take all off the page. Idempotent."""
        for command in self._commands:
            command.remove()
        self._commands.clear()
        for folder in self._folders.values():
            folder.close()
        self._folders.clear()
