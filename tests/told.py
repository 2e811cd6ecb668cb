"""Systems of which a test tells a page, in place of running ones."""

from __future__ import annotations

from contextlib import asynccontextmanager

import msgspec
from served import TOKEN

from mdm.snapshots import EnsembleFrame, Frame, RecordedRun, Ring, Scene
from mdm.snapshots.frame import EnsembleScene, PredicateScene
from mdm.version import __version__
from mdm.views.web import PageServer

DECIDES = EnsembleFrame("deciding", 1.0, epoch=3, action="go", decisions=4)


class Told:
    """A running system that a test tells of: its scene, and how its ensembles are."""

    def __init__(self, ensembles=("ada/patrol", "bob/patrol"), *, began=1, control=False):
        self.ring = Ring()
        self.generation = 0
        self.commands = []
        self._began, self._control = began, control
        self.turn(ensembles)

    def turn(self, ensembles, frames=None, judgements=()):
        """Have other ensembles, each deciding unless their frames are given, and what is judged, the worst first."""
        self._judgements = judgements
        self._ensembles = ensembles
        self._frames = tuple([DECIDES] * len(ensembles)) if frames is None else frames
        self.generation += 1

    def scene(self):
        ensembles = tuple(EnsembleScene(path, -1, "", "an MDP") for path in self._ensembles)
        predicates = tuple(PredicateScene(f"{agent}: Near", "set by code", True) for agent in ("ada", "bob"))
        what = (__version__, "live", "a team", self._began, 0.0, 0.0, ensembles, predicates)
        return Scene(*what, control=self._control)

    def frame(self, close=()):
        worst = str(self._judgements[0]) if self._judgements else ""
        return Frame(12.0, self._frames, (True, None), (0.0, 0.0), judgements=self._judgements, headline=worst)

    def encoded(self, close=()):
        return msgspec.json.encode(self.frame(close))

    def command(self, command, ensemble):
        self.commands.append((command, ensemble))

    async def explain(self, ensemble, time=None):
        return None

    async def draw(self, ensemble, time=None, opened=()):
        return ()


class Kept(Told):
    """A record of a minute, in which something happens each two seconds."""

    def scene(self):
        return msgspec.structs.replace(super().scene(), source="record", title="a record", last=60.0)

    def frame(self, seconds=0.0, close=()):
        return msgspec.structs.replace(super().frame(), time=min(max(seconds, 0.0), 60.0))

    def step(self, kind, seconds, *, back=False):
        self.commands.append((kind, back))
        return min(max(seconds + (-2.0 if back else 2.0), 0.0), 60.0)

    async def course(self, ensemble, first, last):
        return None

    def after(self, cursor, most, *, rare=False):
        return self.ring.after(cursor, most)

    def lanes(self, first, last, paths, predicates, most):
        return [event for event in self.ring if event.kind in {"mode", "life", "decision", "predicate"}]


@asynccontextmanager
async def served(told, port=0, *, control=False):
    """Serve a page of it; yield its address."""
    live = not isinstance(told, Kept | RecordedRun)
    server = PageServer(told, port=port, live=live, token=TOKEN, control=control)
    await server.open()
    try:
        yield server.address
    finally:
        await server.close()
