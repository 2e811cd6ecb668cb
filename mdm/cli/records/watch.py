"""``mdm watch``: a running system, by its page's address, or a record, in the terminal."""

from __future__ import annotations

import asyncio
import os
import re
import sys
import time as times
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.cli.records.page import paths_of, recorded_run, run_of
from mdm.cli.usage import UsageError
from mdm.errors import Error
from mdm.runtime import run as run_program
from mdm.snapshots import Event, Frame, Scene
from mdm.views.terminal import Terminal, rich
from mdm.views.web.client import Socket, opened

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from mdm.snapshots import RecordedRun
    from mdm.views.web.team import RecordedTeam

_PERIOD = 0.25
_PATIENCE = 5.0
"""Seconds that one picture waits for an ensemble and, of a team, for all agents: they come to its page one by one."""
_BATCH = 100
"""Events that one message may bring, and there are hardly more: of a run that is old a thousand come with each."""
_STEPS = {"d": "decision", "n": "change", "f": "fault", "m": "mode", "j": "judgement"}
_WORDS = {
    "decision": "decision",
    "change": "decision for another action",
    "fault": "fault",
    "mode": "change of mode",
    "judgement": "judgement",
}
_KEY = re.compile("\x1b\\[.|.", re.DOTALL)
_ARROWS = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left"}


class _Told(msgspec.Struct, frozen=True):
    """A message of a page's socket."""

    scene: Scene | None = None
    frame: Frame | None = None
    events: tuple[Event, ...] = ()
    cursor: int = 0


def run(arguments: argparse.Namespace) -> int:
    """Watch until q or Ctrl-C; return the exit status."""
    rich()
    if arguments.authority is not None and not arguments.source.startswith("https://"):
        raise UsageError("--authority is for the address of a page with TLS, which begins with https://")
    if arguments.source.startswith(("http://", "https://")):
        if arguments.at is not None:
            raise UsageError("--at is for a record: a running system has no past")
        run_program(lambda: _watch_page(arguments.source, arguments.authority, once=arguments.once))
    else:
        runs = {name: recorded_run(path) for name, path in paths_of(arguments.source).items()}
        shown = run_of(arguments.source, runs)
        run_program(lambda: _watch_record(shown, arguments.at, once=arguments.once))
    return 0


async def _watch_record(shown: RecordedRun | RecordedTeam, at: float | None, *, once: bool) -> None:
    terminal = Terminal(shown.scene())
    terminal.hear([msgspec.json.decode(each, type=Event) for each in shown.after(0, sys.maxsize)[0]])
    time = at if at is not None else (shown.last if once else shown.first)
    playing, before, told = False, times.monotonic(), ""
    with _screen(once=once) as (draw, keys):
        while True:
            now = times.monotonic()
            if playing:
                time = min(shown.last, time + now - before)
            before = now
            status = "▶ playing" if playing else f"❚❚ {told}space plays, d n f m j step, q ends"
            draw(terminal, shown.frame(time, terminal.close), status)
            if once:
                return
            key = await keys(_PERIOD)
            if key == "q":
                return
            told = "" if key else told
            if key == " ":
                playing = not playing
            elif key in {"up", "down"}:
                terminal.choose(1 if key == "down" else -1)
            elif key in {"left", "right"}:
                time, playing = min(shown.last, max(shown.first, time + (1 if key == "right" else -1))), False
            elif key.lower() in _STEPS:
                (time, told), playing = _stepped(shown, key, time), False


def _stepped(shown: RecordedRun | RecordedTeam, key: str, time: float) -> tuple[float, str]:
    """Return the second to which a key steps, and a sentence where nothing is there."""
    kind, back = _STEPS[key.lower()], key.isupper()
    to = shown.step(kind, time, back=back)  # type: ignore[arg-type]
    if round(1e9 * (to - time)):
        return to, ""
    return to, f"no {'earlier' if back else 'further'} {_WORDS[kind]}; "


async def _watch_page(url: str, authority: str | None, *, once: bool) -> None:
    terminal: Terminal | None = None
    cursor, began = 0, times.monotonic()
    async with opened(url, authority=authority) as socket:
        with _screen(once=once) as (draw, keys):
            while True:
                told = await _next(socket)
                if told.scene is not None:
                    if told.scene.source == "record":
                        raise Error(f"this page shows a record: watch its file, mdm watch {told.scene.title}")
                    chosen = 0 if terminal is None else terminal.selected
                    terminal = Terminal(told.scene)
                    terminal.selected = chosen
                if terminal is not None and told.frame is not None:
                    terminal.hear(told.events)
                    cursor = told.cursor
                    if once:
                        is_seen = bool(terminal.close) and terminal.close[0] in told.frame.details
                        is_seen = is_seen and not told.frame.missing and len(told.events) < _BATCH
                        if is_seen or times.monotonic() - began > _PATIENCE:
                            draw(terminal, told.frame, "● live")
                            return
                    else:
                        draw(terminal, told.frame, "● live, q ends")
                        key = await keys(_PERIOD)
                        if key == "q":
                            return
                        if key in {"up", "down"}:
                            terminal.choose(1 if key == "down" else -1)
                close = [] if terminal is None else list(terminal.close)
                await socket.say({"say": "drawn", "cursor": cursor, "close": close})


async def _next(socket: Socket) -> _Told:
    try:
        return msgspec.json.decode(await socket.receive(), type=_Told)
    except msgspec.ValidationError:
        raise Error("the page is of another version of mdm: watch with the one that runs there") from None


@contextmanager
def _screen(*, once: bool) -> Iterator[tuple[Any, Any]]:
    """Yield a function that draws, and one that waits for a key for some seconds."""
    parts = rich()
    console = parts.Console()
    if once or not console.is_terminal:
        yield lambda terminal, frame, status: console.print(terminal.picture(frame, status=status)), _no_key
        return
    with parts.Live(console=console, screen=True, auto_refresh=False) as live, _keys() as keys:

        def draw(terminal: Terminal, frame: Frame, status: str) -> None:
            live.update(terminal.picture(frame, height=console.height, status=status), refresh=True)

        yield draw, keys


async def _no_key(period: float) -> str:
    await asyncio.sleep(period)
    return ""


@contextmanager
def _keys() -> Iterator[Any]:
    """Yield a function that waits for a key; the terminal tells each at once meanwhile."""
    try:
        import termios  # noqa: PLC0415 - not everywhere
        import tty  # noqa: PLC0415
    except ImportError:
        yield _no_key
        return
    descriptor = sys.stdin.fileno()
    if not os.isatty(descriptor):
        yield _no_key
        return
    before = termios.tcgetattr(descriptor)
    pressed: asyncio.Queue[str] = asyncio.Queue()
    loop = asyncio.get_running_loop()

    def read() -> None:
        text = os.read(descriptor, 64).decode(errors="replace")
        for key in _KEY.findall(text):  # several, where they were pressed faster than pictures are drawn
            pressed.put_nowait(_ARROWS.get(key, key))

    async def key(period: float) -> str:
        with suppress(TimeoutError):
            return await asyncio.wait_for(pressed.get(), period)
        return ""

    tty.setcbreak(descriptor)
    loop.add_reader(descriptor, read)
    try:
        yield key
    finally:
        loop.remove_reader(descriptor)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
