"""A config file that is no YAML, said in one line. LeRobot's reader ends with a traceback that names neither line nor
cause."""

import sys
from pathlib import Path

_OPTION = "--config_path="
_BAD_OPTIONS = 2  # exit status of a command that refuses its options, as argparse has it


def refuse_unreadable() -> None:
    """End a LeRobot command whose config file YAML cannot read; what else is wrong with the file LeRobot says.

    Raises:
        SystemExit: names file, line and cause.
    """
    if not Path(*sys.argv[:1]).stem.startswith("lerobot"):
        return
    given = next((argument for argument in sys.argv[1:] if argument.startswith(_OPTION)), _OPTION)
    path = Path(given.removeprefix(_OPTION))
    if path.suffix not in (".yaml", ".yml"):
        return
    import yaml  # this module is loaded by every process of ours

    try:
        yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError):
        return
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "cannot be read"
        cause = "a tab; indent with blanks" if "'\\t'" in problem else f"{problem}; it is no YAML"
        sys.stderr.write(f"error: {path}{line}: {cause}\n")
        raise SystemExit(_BAD_OPTIONS) from None
