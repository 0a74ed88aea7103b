"""Every kind of flag says what it means, and the page shows it."""

from lerobot_robot_yam.face.datasets.check.flags import KINDS, Kind
from tests.support.paths import ROOT


def test_the_page_has_the_table_of_kinds():
    assert list(KINDS) == list(Kind)
    rows = [line for line in (ROOT / "docs" / "dataset-check.md").read_text().splitlines() if line.startswith("| `")]
    assert rows == [f"| `{kind}` | {meaning} | {remedy} |" for kind, (meaning, remedy) in KINDS.items()]
