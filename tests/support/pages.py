"""The documents as their readers see them: README, the pages of docs/, their blocks of code."""

import re
import textwrap

from tests.support.paths import ROOT

README = ROOT / "README.md"
PAGES = (README, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(ROOT.glob("docs/*.md")))


def blocks(text, language):
    """Code of every fenced block of that language."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", text, re.DOTALL | re.MULTILINE)
    return [textwrap.dedent(code) for _, code in found]


def block(page, language, containing):
    """The one block of a page that has this in it."""
    (found,) = [code for code in blocks((ROOT / page).read_text(), language) if containing in code]
    return found


def section(page, heading):
    """Text of a page from that heading to the next one of any rank."""
    (found,) = re.findall(rf"^#+ {re.escape(heading)}\n(.*?)(?=^#+ |\Z)", (ROOT / page).read_text(), re.DOTALL | re.M)
    return found


def prose(text):
    """A document without its blocks of code and its tables."""
    text = re.sub(r"^ *```.*?^ *```$", "", text, flags=re.DOTALL | re.MULTILINE)
    return "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("|"))
