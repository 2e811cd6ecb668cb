"""A record as one file that a browser opens without a server: the page, its pictures, and what they are drawn from.

The file has the frames at which something happened, and one a second; of a long record each stands for some time, so
that an hour takes five megabytes at most. Of many decisions some are explained, with their policies drawn.
"""

from __future__ import annotations

import asyncio
import base64
import gzip
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.snapshots import Event
from mdm.snapshots.why import Why

if TYPE_CHECKING:
    from mdm.snapshots import RecordedRun
    from mdm.views.web.team import RecordedTeam

HOURLY = 5_000_000
"""Bytes of an hour, at most; a shorter time may have as many."""
_FRAMES = 6_000
"""Frames of an hour, at most."""
_EVENTS = 20_000
"""Events of a kind of an ensemble or predicate; of more some stand together."""
_LOOKS = 200
"""Decisions of all ensembles that are explained, and at which policies are drawn."""
_CLOSE = 16
_STATIC = Path(__file__).parent / "static"
_IMPORT = re.compile(r'from "\./([\w/-]+\.js)"')


def page_file(run: RecordedRun | RecordedTeam, first: float | None = None, last: float | None = None) -> bytes:
    """Return a record as a page that is one file.

    Args:
        run: The record.
        first: From this second on; by default its first one.
        last: To this second; by default its last one.

    Example:
        >>> from mdm.recording import Record
        >>> from mdm.snapshots import RecordedRun
        >>> Path("run.html").write_bytes(page_file(RecordedRun(Record("run.mcap"))))  # doctest: +SKIP
    """
    first = run.first if first is None else min(max(first, run.first), run.last)
    last = run.last if last is None else min(max(last, first), run.last)
    hours = max(1.0, (last - first) / 3600)
    most, page = round(_FRAMES * hours), _page()
    while True:
        data = gzip.compress(msgspec.json.encode(_told(run, first, last, most)), 6, mtime=0)
        found = page.replace(b"<record>", base64.b64encode(data))
        if len(found) <= HOURLY * hours or most < _CLOSE:
            return found
        most //= 2


def _told(run: RecordedRun | RecordedTeam, first: float, last: float, most: int) -> dict[str, Any]:
    """Return all that the page is told, with so many frames at most."""
    scene = msgspec.structs.replace(run.scene(), first=first, last=last, pending=False)
    paths = tuple([each.path for each in scene.ensembles])
    events = run.lanes(first, last, paths, [each.name for each in scene.predicates], min(_EVENTS, most))
    rare = [msgspec.json.decode(each, type=Event) for each in run.after(0, 1 << 62, rare=True)[0]]
    events = sorted([*events, *(each for each in rare if each.time <= last)], key=lambda each: each.time)
    times = {round(each.time, 6) for each in events if first <= each.time <= last} | {first, last}
    times |= {first + second for second in range(int(last - first))}
    step = -(-len(times) // most)
    frames = [run.frame(time, paths[:_CLOSE]) for time in sorted(times)[::step]]

    each_has = -(-min(_LOOKS, most) // max(1, len(paths[:_CLOSE])))

    async def close(path: str) -> dict[str, Any]:
        decided = [each.time for each in events if (each.kind, each.source) == ("decision", path) and each.time > first]
        looks = [
            {"time": time, "why": await run.explain(path, time), "pictures": await run.draw(path, time)}
            for time in (first, *decided[:: -(-len(decided) // each_has) or 1])
        ]
        return {"course": await run.course(path, first, last), "looks": looks}

    async def closely() -> dict[str, Any]:
        return {path: await close(path) for path in paths[:_CLOSE]}

    why = Why("This file explains other decisions: ask the record, by mdm page or mdm explain.")
    return {"scene": scene, "events": events, "frames": frames, "close": asyncio.run(closely()), "why": why}


def _page() -> bytes:
    """Return the page with all of its files in it, and a place for the record."""
    files = {path.relative_to(_STATIC).as_posix(): path.read_text(encoding="utf-8") for path in _STATIC.rglob("*.*s")}
    files["connection.js"] = files["offline.js"]
    named = {
        name: "data:text/javascript;base64," + base64.b64encode(_IMPORT.sub(r'from "\1"', text).encode()).decode()
        for name, text in files.items()
        if name.endswith(".js")
    }
    page = (_STATIC / "index.html").read_text(encoding="utf-8")
    icon = base64.b64encode((_STATIC / "icon.svg").read_bytes()).decode()
    page = page.replace('href="icon.svg"', f'href="data:image/svg+xml;base64,{icon}"')
    for name in ("vendor/uplot.css", "page.css"):
        page = page.replace(f'<link rel="stylesheet" href="{name}">', f"<style>{files[name]}</style>")
    for name in ("vendor/uplot.js", "scheme.js"):
        page = page.replace(f'<script src="{name}" defer></script>', f"<script>{files[name]}</script>")
    modules = msgspec.json.encode({"imports": named}).decode()
    start = f'<script type="importmap">{modules}</script><script type="module">import "page.js";</script>'
    page = page.replace('<script type="module" src="page.js"></script>', start)
    record = '<script type="text/plain" id="record"><record></script>'
    return page.replace('<div id="page"></div>', f'<div id="page"></div>{record}').encode()
