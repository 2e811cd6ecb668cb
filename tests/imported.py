"""Modules that tests and their programs import, and the next ones do not find."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from places import DATA, EXAMPLES

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def forgetting(*folders: Path) -> Iterator[None]:
    """Forget modules that are imported within: of these folders, of examples, of recorded runs, of files that are gone.

    The next program may have others of their names; and what an example keeps of one run is wrong in another.
    """
    before, path, places = sys.modules.copy(), list(sys.path), {*folders, EXAMPLES, DATA}
    try:
        yield
    finally:
        sys.path[:] = path
        # Nearly always nothing has been: what is imported comes last, and to compare all names takes long.
        if next(reversed(sys.modules)) != next(reversed(before)) or len(sys.modules) != len(before):
            for name in sys.modules.keys() - before.keys():
                file = Path(getattr(sys.modules[name], "__file__", None) or "")
                if places.intersection(file.parents) or not file.exists():
                    del sys.modules[name]
