"""A team's file, with the code and the model that it names, and its agents on a simulated network."""

from __future__ import annotations

from contextlib import AsyncExitStack, asynccontextmanager

from team_robots import rooms

import mdm
from mdm.config.recorded import attach_configuration
from mdm.recording import Recorder
from mdm.team.transport.network import Network

CODE = """
done = []

def stay():
    done.append("stay")

def go():
    done.append("go")

async def sense(system):
    done.append(system.agent)
    import asyncio
    await asyncio.Event().wait()
"""

FILE = """
tasks = ["team_code:sense"]

[team]
name = "rooms"
agents = ["a", "b"]
port = 7600

[predicates]
InLab = {}

[ensembles.joint]
model = "rooms.npz"
policy = [0, 1, 2, 3]

[ensembles.joint.states]
room_a = { predicates = { lab = "InLab" }, owner = "a" }
room_b = { predicates = { lab = "InLab" }, owner = "b" }

[ensembles.joint.actions]
stay = "team_code:stay"
go = "team_code:go"
"""


def write(folder, *changes, text=FILE):
    """Write a team's file, with replacements, and return its path."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    (folder / "team_code.py").write_text(CODE)
    mdm.save_model(rooms(), folder / "rooms.npz")
    (folder / "team.toml").write_text(text)
    return folder / "team.toml"


@asynccontextmanager
async def running(path, *, names=None, records=None, **options):
    """Run the systems of a team's file on a simulated network, each in a runtime of its own as in its own process.

    Yields the systems by agent, and the network. What they do is recorded in a folder, if one is given.
    """
    team = mdm.config.load_team(path)
    systems = {}
    if records is not None:
        records.mkdir()
    async with AsyncExitStack() as stack:
        runtimes = [
            await stack.enter_async_context(mdm.Runtime(log=None, record=_recorder(path, name, records)))
            for name in names or team.names
        ]
        network = Network(runtimes[0].clock, team=team.name, **options)
        for name, runtime in zip(names or team.names, runtimes, strict=True):
            systems[name] = mdm.load_system(path, agent=name, transport=network.transport(name))
            await runtime.start(systems[name])
        yield systems, network


def _recorder(path, name, folder):
    if folder is None:
        return None
    recorder = Recorder(folder / f"{name}.mcap")
    attach_configuration(recorder, path, agent=name)
    return recorder
