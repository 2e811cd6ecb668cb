"""The folder of the examples; and a new folder, whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import mdm
from mdm.errors import Error

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["examples", "making"]


def examples() -> Path:
    """Return the folder of the examples: within the installed package, or beside it in a clone.

    Raises:
        Error: If they are not there.
    """
    package = Path(mdm.__file__).parent
    for place in (package / "examples", package.parent / "examples"):
        if (place / "q_table.py").is_file():
            return place
    raise Error(f"the examples are not beside the package in {package}: install the wheel, or work in a clone")


@contextmanager
def making(target: Path) -> Iterator[Path]:
    """Yield a folder to fill; when it is filled, it becomes the target, which is empty or not there before.

    Raises:
        Error: If the target is a file, or a folder that is not empty.
        OSError: If it cannot be made.
    """
    if target.is_dir():
        if any(target.iterdir()):
            raise Error(f"{target}: this folder is not empty; name another one")
    elif target.exists() or target.is_symlink():
        raise Error(f"{target}: this is a file; name a folder")
    parent = target.resolve().parent
    if not parent.is_dir():
        raise Error(f"{target}: there is no folder {parent} to make it in")
    made = Path(tempfile.mkdtemp(prefix=".mdm-", dir=parent))
    try:
        content = made / "content"
        content.mkdir()
        yield content
        content.replace(target.resolve())  # an empty folder is replaced
    finally:
        shutil.rmtree(made, ignore_errors=True)
