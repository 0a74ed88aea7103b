"""Every kind of flag says what it means, and the page shows it."""

from lerobot_robot_yam.face.datasets.check.flags import Kind
from tests.support.paths import ROOT


def test_the_page_has_the_table_of_kinds():
    rows = [line for line in (ROOT / "docs" / "dataset-check.md").read_text().splitlines() if line.startswith("| `")]
    assert rows == [f"| `{kind}` | {kind.meaning} | {kind.remedy} |" for kind in Kind]
