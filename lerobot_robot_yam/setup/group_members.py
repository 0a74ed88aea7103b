"""Members of groups, in the text of /etc/group and /etc/gshadow: four fields, the last one names the members."""

from collections.abc import Callable, Sequence
from typing import NamedTuple


class Member(NamedTuple):
    """A user in a group."""

    group: str
    user: str

    def line_in(self, text: str) -> bool:
        """Whether the text of a file says so."""
        return any(f[0] == self.group and self.user in f[3].split(",") for f in map(_fields, text.splitlines()) if f)


def groups_of(text: str) -> set[str]:
    """Names of all groups of a file."""
    return {fields[0] for fields in map(_fields, text.splitlines()) if fields}


def with_members(text: str, members: Sequence[Member]) -> str:
    """The text with these members added."""
    return _edited(text, members, lambda users, user: [*users, user] if user not in users else users)


def without_members(text: str, members: Sequence[Member]) -> str:
    """The text with these members taken out."""
    return _edited(text, members, lambda users, user: [name for name in users if name != user])


def _edited(text: str, members: Sequence[Member], edit: Callable[[list[str], str], list[str]]) -> str:
    lines = []
    for line in text.splitlines(keepends=True):
        fields = _fields(line.rstrip("\n"))
        users = [name for name in fields[3].split(",") if name] if fields else []
        edited = users
        for member in members:
            if fields and member.group == fields[0]:
                edited = edit(edited, member.user)
        lines.append(line if edited == users else ":".join([*fields[:3], ",".join(edited)]) + "\n")
    return "".join(lines)


def _fields(line: str) -> list[str]:
    fields = line.split(":")
    return fields if len(fields) == 4 else []
