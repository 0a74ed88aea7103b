"""Files of a computer that are changed as one: shown first, written whole, remembered, and undone exactly.

What was changed is remembered in a journal, before it is changed. So an interrupted run can be run again or undone.
"""

import contextlib
import difflib
import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.setup.group_members import Member, without_members
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.paths import write_whole

JOURNAL = "var/lib/yam-setup-can/journal.json"
_AS_ROOT = f"it takes root: {as_root('yam-setup-can')}"
_ACCOUNTS_LOCK = "etc/.pwd.lock"  # of lckpwdf(3): who changes users and groups holds it


@dataclass(frozen=True)
class Change:
    """What becomes of one file.

    Attributes:
        path: below the root, "etc/udev/rules.d/70-yam-can.rules".
        before, after: its text; None where there is no file.
        members: of a file of groups, those who come or go. It is undone by their names: others may change it too.
    """

    path: str
    before: str | None
    after: str | None
    members: tuple[Member, ...] = ()

    def shown(self) -> str:
        """The change for a person to read. Files of groups may hold passwords: only the names are shown."""
        if self.members:
            verb = "joins" if all(m.line_in(self.after or "") for m in self.members) else "leaves"
            return f"/{self.path}: " + ", ".join(f"{m.user} {verb} the group {m.group}" for m in self.members)
        how = "is new" if self.before is None else "goes" if self.after is None else "changes"
        before, after = ((text or "").splitlines() for text in (self.before, self.after))
        lines = list(difflib.unified_diff(before, after, n=0, lineterm=""))[2:]
        return "\n".join([f"/{self.path} {how}:", *(line for line in lines if not line.startswith("@@"))])


class SystemFiles:
    """The files below a root: "/", or a directory that stands for it.

    Raises (every method):
        SetupError: a file cannot be read or written.
    """

    def __init__(self, root: Path):
        self.root = root

    @property
    def live(self) -> bool:
        """Whether this is the computer that we run on."""
        return self.root.resolve() == Path("/")

    def check_writable(self) -> None:
        """Refuse, before anything is asked, to begin what cannot be ended."""
        if not (self.root / "etc").is_dir():
            raise SetupError(f"{self.root} is no root of a system: it has no directory etc")
        if not os.access(self.root / "etc", os.W_OK, effective_ids=True):
            raise SetupError(f"no right to write to {self.root / 'etc'}: {_AS_ROOT}, or look at --dry-run")

    def read(self, path: str) -> str | None:
        """Text of a file, None when there is none."""
        try:
            return (self.root / path).read_text()
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise SetupError(f"/{path} cannot be read: {error}; {_rights(error)}") from error

    def change_to(self, path: str, after: str | None) -> list[Change]:
        """The change that gives a file this text; none when it has it."""
        before = self.read(path)
        return [] if before == after else [Change(path, before, after)]

    def apply(self, changes: Sequence[Change]) -> None:
        """Write the changes, each file whole. They can be undone from before the first is written."""
        if changes:
            journal = self._journal()
            for change in changes:
                _remember(journal, change)
            self._make_directories(journal, [change.path for change in changes])
            self._write_all(changes)

    def undo_changes(self) -> tuple[list[Change], list[str]]:
        """The changes that take back all that was applied, and the files that others have changed since."""
        journal, changes, left = self._journal(), [], []
        for path, entry in journal["files"].items():
            now, members = self.read(path), tuple(Member(*pair) for pair in entry["members"])
            if members:
                there = tuple(member for member in members if member.line_in(now or ""))
                if there:
                    changes.append(Change(path, now, without_members(now or "", there), there))
            elif now in entry["written"]:
                changes += self.change_to(path, entry["before"])
            elif now != entry["before"]:
                left.append(path)
        return changes, left

    def undo(self) -> list[str]:
        """Take back all that was applied; returns the files that were left, since others have changed them."""
        changes, left = self.undo_changes()
        self._write_all(changes)
        made = self._journal()["directories"]
        (self.root / JOURNAL).unlink(missing_ok=True)
        for directory in reversed(made):
            with contextlib.suppress(OSError):  # somebody else keeps things there
                (self.root / directory).rmdir()
        return left

    def _journal(self) -> dict[str, Any]:
        text = self.read(JOURNAL)
        try:
            return json.loads(text) if text is not None else {"files": {}, "directories": []}
        except ValueError as error:
            raise SetupError(f"/{JOURNAL}, what was changed, is damaged ({error}): put a copy back") from error

    def _make_directories(self, journal: dict[str, Any], paths: Sequence[str]) -> None:
        """Write the journal, with the directories that are missing, and make these."""
        missing: dict[str, None] = {}
        for path in (JOURNAL, *paths):
            for parent in [str(p) for p in reversed(Path(path).parents)][1:]:
                if not (self.root / parent).exists() and parent not in journal["directories"]:
                    missing[parent] = None
        journal["directories"] += missing
        self._write(JOURNAL, json.dumps(journal, indent=1) + "\n")

    def _write_all(self, changes: Sequence[Change]) -> None:
        with self._accounts_locked(any(change.members for change in changes)):
            for change in changes:
                if self.read(change.path) != change.before:
                    raise SetupError(f"/{change.path} was changed meanwhile by another program; run it again")
                self._write(change.path, change.after)

    def _write(self, path: str, text: str | None) -> None:
        try:
            if text is None:
                (self.root / path).unlink(missing_ok=True)
            else:
                write_whole(self.root / path, text)
        except OSError as error:
            raise SetupError(f"/{path} cannot be written: {error}; {_rights(error)}") from error

    @contextlib.contextmanager
    def _accounts_locked(self, needed: bool) -> Iterator[None]:
        path = self.root / _ACCOUNTS_LOCK
        if not needed or not path.exists():
            yield
            return
        with path.open("r+") as lock:
            fcntl.lockf(lock, fcntl.LOCK_EX)
            yield


def _remember(journal: dict[str, Any], change: Change) -> None:
    entry = journal["files"].setdefault(change.path, {"before": change.before, "written": [], "members": []})
    if change.members:
        entry["members"] += [[m.group, m.user] for m in change.members if [m.group, m.user] not in entry["members"]]
    elif change.after not in entry["written"]:
        entry["written"].append(change.after)


def _rights(error: Exception) -> str:
    if isinstance(error, PermissionError):
        return _AS_ROOT
    return "repair that, then run it again: it goes on"
