"""Programs that run in this process, as each would in one of its own: to start Python takes half a second of processor.

Their arguments, folder, streams, signals and modules are their own; afterwards all is as it was before.
"""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import signal
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from imported import forgetting

from mdm.cli import main
from mdm.compilation import COMPILE_TIME

if TYPE_CHECKING:
    from collections.abc import Callable

_LOGGED = re.compile(r"(?:[\d:.]+ )?\[(?:info|warning) +\] |mdm: [\w/]+: stale(?:_input)?: ")
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Done(NamedTuple):
    """How a program has ended."""

    status: int
    output: str
    errors: str

    @property
    def wrong(self) -> str:
        """The lines of its errors that are no lines of the log, and none of an input that was lost on purpose."""
        return "".join(line for line in self.errors.splitlines(keepends=True) if not _LOGGED.match(line))


def mdm(*words: object, folder: Path | None = None, given: str = "") -> Done:
    """Run the command with these words, in a folder, with a text as its input.

    Whether kernels are kept on disk is not its matter: that they are compiled is not told.
    """

    def program() -> int:
        tell, COMPILE_TIME.go_on = COMPILE_TIME.go_on, lambda: None  # type: ignore[method-assign]
        try:
            return main(sys.argv[1:])
        finally:
            COMPILE_TIME.go_on = tell  # type: ignore[method-assign]

    return _run(program, ["mdm", *map(str, words)], folder, given)


def script(path: Path, *arguments: object, folder: Path | None = None, output: io.TextIOWrapper | None = None) -> Done:
    """Run a file of Python with these arguments, in a folder; what it prints goes to a stream that is given."""

    def program() -> int:
        sys.path.insert(0, str(path.parent))
        runpy.run_path(str(path), run_name="__main__")
        return 0

    return _run(program, [str(path), *map(str, arguments)], folder, "", output)


def suite(folder: Path) -> list[str]:
    """Call the functions that are the tests of a folder's files; return their names."""
    called = []

    def program() -> int:
        sys.path.insert(0, str(folder))
        for path in sorted(folder.glob("test_*.py")):
            for name, value in runpy.run_path(str(path)).items():
                if name.startswith("test_"):
                    value()
                    called.append(name)
        return 0

    _run(program, [str(folder / "suite")], folder, "")
    return called


def _run(
    program: Callable[[], int], words: list[str], folder: Path | None, given: str, to: io.TextIOWrapper | None = None
) -> Done:
    own = (Path(words[0]).parent,) if folder is None else (Path(words[0]).parent, folder)
    arguments, stdin, handlers = sys.argv, sys.stdin, {each: signal.getsignal(each) for each in _SIGNALS}
    with tempfile.TemporaryDirectory() as place:  # for files: a program may put their descriptors elsewhere
        files = Path(place, "output"), Path(place, "errors")
        sys.argv, sys.stdin = words, io.TextIOWrapper(io.BytesIO(given.encode()), encoding="utf-8")
        try:
            with (
                forgetting(*own),
                contextlib.chdir(folder or Path.cwd()),
                files[0].open("w", encoding="utf-8") as output,
                files[1].open("w", encoding="utf-8") as errors,
                contextlib.redirect_stdout(to or output),
                contextlib.redirect_stderr(errors),
            ):
                status = _status(program)
        finally:
            sys.argv, sys.stdin = arguments, stdin
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return Done(status, *(file.read_text(encoding="utf-8") for file in files))


def _status(program: Callable[[], int]) -> int:
    """Run a program; return its status, as Python does at its end."""
    try:
        return program()
    except SystemExit as stop:
        if isinstance(stop.code, str):
            sys.stderr.write(f"{stop.code}\n")
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
