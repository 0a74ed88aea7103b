"""What readers are told to install: never this package by its bare name, which is another project's on the index.

Nor its extras without -e: that would replace a clone's own installation.
"""

import re

from tests.support.paths import ROOT

PLACES = ("README.md", "pyproject.toml", "docs/*.md", "configs/**/*.yaml", "scripts/*", "lerobot_*_yam/**/*.py")
BY_NAME = re.compile(r"pip3? install\b[^\n]*\blerobot[-_](robot|teleoperator)[-_]yam", re.IGNORECASE)
NOT_EDITABLE = re.compile(r"pip3? install(?: (?!-e\b|--editable\b)\S+)* ['\"]?\.\[")
SEAM = re.compile(r"""["']\s*\n\s*f?["']|\\\n\s*""")  # where a message or a command goes on in the next line


def test_nobody_is_told_to_install_a_strangers_package():
    texts = [path for place in PLACES for path in ROOT.glob(place) if path.is_file()]
    assert len(texts) > 100
    found = {path: match[0] for path in texts if (match := BY_NAME.search(SEAM.sub("", path.read_text())))}
    assert not found, 'use own_commands.install_extra, or say pip install -e ".[EXTRA]" in the clone'
    assert not [path for path in texts if NOT_EDITABLE.search(SEAM.sub("", path.read_text()))]
