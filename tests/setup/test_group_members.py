"""Members of groups in the text of /etc/group."""

from lerobot_robot_yam.setup.group_members import Member, groups_of, with_members, without_members

TEXT = "root:x:0:\nvideo:x:44:ada,eve\ninput:x:104:\n# no group\n"


def test_members_come_and_go_and_nothing_else_changes():
    new = (Member("input", "ada"), Member("input", "bob"), Member("video", "bob"))
    joined = with_members(TEXT, new)
    assert joined == "root:x:0:\nvideo:x:44:ada,eve,bob\ninput:x:104:ada,bob\n# no group\n"
    assert all(member.line_in(joined) and not member.line_in(TEXT) for member in new)
    assert with_members(joined, new) == joined and without_members(joined, new) == TEXT
    assert groups_of(TEXT) == {"root", "video", "input"}


def test_a_name_that_begins_like_another_is_another():
    assert not Member("video", "ad").line_in(TEXT) and without_members(TEXT, [Member("video", "ad")]) == TEXT
