"""Where things of this repository are, wherever in it a test stands."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "golden"
SCRIPTS = ROOT / "scripts"
