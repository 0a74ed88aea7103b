"""A directory that appears under its name only when it is whole."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_aside(target: Path) -> Iterator[Path]:
    """A path beside `target` to create a directory at: it becomes `target` at the end, or is removed after an error.

    Whatever is written beside that path, in the same new directory, is removed at the end.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    # A new name: a directory that exists already, whatever its name, is somebody's, and may be what is copied.
    aside = Path(tempfile.mkdtemp(prefix=f"{target.name}.partial.", dir=target.parent))
    try:
        yield aside / "whole"  # not `aside` itself, which only its owner may read
        (aside / "whole").rename(target)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
