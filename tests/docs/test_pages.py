"""The pages of docs/: each is in the index, all have one form, and their links and modules lead somewhere."""

import re

import pytest

from tests.support.pages import PAGES, README, prose
from tests.support.paths import ROOT

INDEX = ROOT / "docs" / "README.md"
PACKAGES = r"lerobot_(?:robot|strategy|teleoperator)_yam"
LONGEST_LINE = 120
ELSEWHERE = ("scripts/serve_policy.py",)  # openpi's
everywhere = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def links(page):
    """(path, anchor) of every link of a page to another file of this repository."""
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if "://" not in target:
            path, _, anchor = target.partition("#")
            yield (page.parent / path).resolve() if path else page, anchor


def anchors(page):
    """Names by which GitHub links to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def resolves(dotted):
    """Whether a dotted name is a module of ours, or a name that one of them has."""
    names = dotted.split(".")
    for length in range(len(names), 0, -1):
        path = ROOT.joinpath(*names[:length])
        found = [file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()]
        rest = names[length:]
        if path.is_dir() and not found:
            return not rest
        if found:
            return not rest or re.search(rf"\b{rest[0]}\b", found[0].read_text()) is not None
    return False


def is_file(path):
    """Whether a path of a Python file, from the root, a package, the scripts or the tests on, exists."""
    places = ("", "lerobot_robot_yam", "lerobot_strategy_yam", "lerobot_teleoperator_yam")
    return any((ROOT / place / path).is_file() for place in places)


def test_the_index_has_one_line_for_each_page():
    listed = {path for path, _ in links(INDEX) if path != README}
    assert listed == {*ROOT.glob("docs/[!R]*.md"), ROOT / "docs/training-proof/report.md"}
    rows = [line for line in INDEX.read_text().splitlines() if line.startswith("| [")]
    assert len({row.split(" | ")[0] for row in rows}) == len(rows) and all(len(row) <= LONGEST_LINE for row in rows)


@everywhere
def test_pages_have_one_form(page):
    text = page.read_text()
    assert re.match(r"# \S.*\n\n(?!#|\||```|- )\S", text), "a title, then a paragraph that says what the page is for"
    assert len(re.findall(r"^# ", prose(text), re.MULTILINE)) == 1
    assert not re.findall(r"[^\n]\n#+ |^#+ .*\n(?!\n)", prose(text) + "\n\n", re.MULTILINE), "blank lines at headings"
    assert all(re.findall(r"^ *```(.*)$", text, re.MULTILINE)[::2]), "a block says its language"
    assert not [line for line in prose(text).splitlines() if len(line) > LONGEST_LINE and "](http" not in line]


@everywhere
def test_links_lead_to_files_and_headings(page):
    for path, anchor in links(page):
        assert path.exists(), path
        assert not anchor or anchor in anchors(path), f"{path.name}#{anchor}"


@everywhere
def test_modules_that_are_named_exist(page):
    text = page.read_text()
    dotted = re.findall(rf"\b{PACKAGES}(?:\.\w+)+", text)
    assert not [name for name in dotted if not resolves(name)]
    paths = re.findall(r"(?<![\w/.])(?:\w+/)+(?!(?:test_)?NAME)\w+\.py\b", text)
    assert not [path for path in paths if not is_file(path) and path not in ELSEWHERE]


def test_the_look_for_modules_can_fail():
    assert resolves("lerobot_robot_yam.arm.kinematics.YamKinematics") and is_file("arm/kinematics.py")
    assert not resolves("lerobot_robot_yam.arm.nothing") and not resolves("lerobot_robot_yam.arm.kinematics.Nothing")
    assert not is_file("arm/nothing.py")
