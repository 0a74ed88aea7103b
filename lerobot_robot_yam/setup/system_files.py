"""System files that are changed together: changes are shown first, written atomically, recorded, and undone exactly.

Each change is written to a journal before it is applied, so an interrupted run can be run again or undone.
"""

import contextlib
import difflib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import SetupError
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.paths import write_whole

JOURNAL = "var/lib/yam-setup-can/journal.json"
_GROUPS = "etc/group"
_OURS = re.compile(r"etc/(udev/rules\.d|systemd/system|security/limits\.d)/(\d+-)?yam[\w.@-]*")  # files in a journal
# name of a user or group; for limits.d, * and @ begin patterns, and for usermod - an option
ACCOUNT = re.compile(r"[A-Za-z_][\w.-]*\$?", re.ASCII)
_AS_ROOT = f"it takes root: {as_root('yam-setup-can')}"


@dataclass(frozen=True)
class FileChange:
    """Change of one file.

    Attributes:
        path: path below the root, "etc/udev/rules.d/70-yam-can.rules".
        before, after: text of the file; None: the file does not exist.
    """

    path: str
    before: str | None
    after: str | None

    def shown(self) -> str:
        """Format the change for display."""
        how = "is new" if self.before is None else "goes" if self.after is None else "changes"
        before, after = ((text or "").splitlines() for text in (self.before, self.after))
        lines = list(difflib.unified_diff(before, after, n=0, lineterm=""))[2:]
        return "\n".join([f"/{self.path} {how}:", *(line for line in lines if not line.startswith("@@"))])


@dataclass(frozen=True)
class GroupChange:
    """Groups that a user joins, or leaves again. `SystemTools.load` changes the groups with `usermod`."""

    user: str
    groups: tuple[str, ...]
    joins: bool = True

    def shown(self) -> str:
        """Format the change for display."""
        verb = "joins" if self.joins else "leaves"
        return f"/{_GROUPS}: " + ", ".join(f"{self.user} {verb} the group {group}" for group in self.groups)


Change = FileChange | GroupChange


class SystemFiles:
    """Files below a root: "/", or a directory in place of "/".

    Raises (every method):
        SetupError: a file cannot be read or written.
    """

    def __init__(self, root: Path):
        self.root = root

    @property
    def live(self) -> bool:
        """Whether the root is the root of this computer."""
        return self.root.resolve() == Path("/")

    def check_writable(self) -> None:
        """Check that the root is a writable system root, before anything is asked or changed."""
        if not (self.root / "etc").is_dir():
            raise SetupError(f"{self.root} is no root of a system: it has no directory etc")
        if not os.access(self.root / "etc", os.W_OK, effective_ids=True):
            raise SetupError(f"no right to write to {self.root / 'etc'}: {_AS_ROOT}, or look at --dry-run")

    def read(self, path: str) -> str | None:
        """Read a file; return None if the file does not exist."""
        try:
            return self._inside(path).read_text()
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise SetupError(f"/{path} cannot be read: {error}; {_advice(error)}") from error

    def members(self) -> dict[str, list[str]]:
        lines = [line.split(":") for line in (self.read(_GROUPS) or "").splitlines()]
        return {fields[0]: fields[3].split(",") for fields in lines if len(fields) == 4}

    def change_to(self, path: str, after: str | None) -> list[Change]:
        """Return the change that gives a file this text; [] if the file already has this text."""
        before = self.read(path)
        return [] if before == after else [FileChange(path, before, after)]

    def apply(self, changes: Sequence[Change]) -> None:
        """Write the journal, then each file atomically; all changes can be undone, even after an interruption."""
        if not changes:
            return
        journal = self._journal()
        for change in changes:
            if isinstance(change, FileChange):
                entry = journal["files"].setdefault(change.path, {"before": change.before, "written": []})
                entry["written"].append(change.after)
            else:
                joined = journal["groups"].setdefault(change.user, [])
                joined += [group for group in change.groups if group not in joined]
        self._write(JOURNAL, json.dumps(journal, indent=1) + "\n")
        self.write(changes)

    def write(self, changes: Sequence[Change]) -> None:
        """Write each file atomically, unless another program has changed the file since the change was prepared."""
        for change in changes:
            if isinstance(change, FileChange):
                if self.read(change.path) != change.before:
                    raise SetupError(f"/{change.path} was changed meanwhile by another program; run it again")
                self._write(change.path, change.after)

    def undo_changes(self) -> tuple[list[Change], list[str]]:
        """Return the changes that undo all applied changes, and the paths of files changed by others since."""
        journal, changes, left = self._journal(), [], []
        for path, entry in journal["files"].items():
            now = self.read(path)
            if now in entry["written"]:
                changes += self.change_to(path, entry["before"])
            elif now != entry["before"]:
                left.append(path)
        for user, groups in journal["groups"].items():
            there = tuple(group for group in groups if user in self.members().get(group, ()))
            changes += [GroupChange(user, there, joins=False)] if there else []
        return changes, left

    def forget(self) -> None:
        """Remove the journal, after all changes were undone."""
        (self.root / JOURNAL).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            (self.root / JOURNAL).parent.rmdir()

    def _journal(self) -> dict[str, Any]:
        text = self.read(JOURNAL)
        try:
            journal = {"files": {}, "groups": {}} | json.loads(text if text is not None else "{}")
            _check(journal)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise SetupError(
                f"/{JOURNAL}, what was changed, is damaged ({error}): put a copy back, or undo by hand what it names "
                "(`yam-setup-can --list` shows the names), then remove it"
            ) from error
        return journal

    def _inside(self, path: str) -> Path:
        """Return a path below the root. Raises SetupError: a link leads out of the root."""
        found = self.root / path
        if not found.resolve().is_relative_to(self.root.resolve()):
            raise SetupError(f"{found} leads to {found.resolve()}, out of {self.root}: remove that link")
        return found

    def _write(self, path: str, text: str | None) -> None:
        try:
            if text is None:
                self._inside(path).unlink(missing_ok=True)
            else:
                write_whole(self._inside(path), text)
        except OSError as error:
            raise SetupError(f"/{path} cannot be written: {error}; {_advice(error)}") from error


def _check(journal: dict[str, Any]) -> None:
    """Check the types of a journal, and that it names only what `apply` changes. Raises ValueError and more."""
    for path, entry in journal["files"].items():
        texts = [entry["before"], *entry["written"]]
        if not _OURS.fullmatch(path) or not all(text is None or isinstance(text, str) for text in texts):
            raise ValueError(f"no change of {path!r} is ours")
    for user, groups in journal["groups"].items():
        if not all(ACCOUNT.fullmatch(name) for name in (user, *groups)) or not isinstance(groups, list):
            raise ValueError(f"no groups of {user!r} are ours")


def _advice(error: Exception) -> str:
    return _AS_ROOT if isinstance(error, PermissionError) else "repair that, then run it again: it goes on"
