"""What a team's agents hold in memory, and how long each takes from its start to its first step.

On a busy machine the processor's time until then says more than the time that passed.

Agents are processes of `mdm run`, all on this machine. Memory is what the system counts of a process once all agents
have taken some steps: RSS counts pages that processes share in each of them, PSS divides them among those that do. The
package is compiled to bytecode first, as one that is installed: without it half of a start is the work of the compiler.
"""

from __future__ import annotations

import compileall
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from measurement import parser, report, table

import mdm
from mdm.models import POMDP, Factor, FactoredPOMDP, Node, Space, Table, TwoSliceNetwork
from mdm.policies import AlphaVectors

if TYPE_CHECKING:
    from collections.abc import Callable

PATIENCE = 600.0  # seconds until all agents have taken their steps
STEPS = 4
CODE = """
import asyncio

async def live(system):
    while True:
        await asyncio.sleep(0.1)
        system.predicates.occur("First")

def act():
    pass
"""


def doors(agents: int) -> POMDP:
    """Return a task of so many agents that hear, each for itself, which of two states it is, as matrices."""
    hears = np.array([[0.85, 0.15], [0.15, 0.85]])
    joint = np.ones((2, 1))
    for _ in range(agents):
        joint = np.einsum("so,sp->sop", joint, hears).reshape(2, -1)
    actions = 2**agents
    return POMDP(
        [np.full((2, 2), 0.5)] * actions,
        [joint] * actions,
        np.zeros((2, actions)),
        discount=0.9,
        actions=Space([Factor(f"agent{agent}", ["wait", "go"]) for agent in range(agents)]),
        observation_names=Space([Factor(f"agent{agent}", ["left", "right"]) for agent in range(agents)]),
    )


def listeners(agents: int) -> POMDP:
    """Return a task of so many agents that hear best which of two states it is by one of three actions, as factors."""
    state, after = Node("state", 0), Node("next_state", 0)
    hears = np.full((3, 2, 3), 1 / 3)  # action, next state, sound
    hears[0] = [[0.8, 0.1, 0.1], [0.1, 0.8, 0.1]]
    hears[1] = [[0.5, 0.3, 0.2], [0.3, 0.5, 0.2]]
    network = TwoSliceNetwork(
        Space.single("tiger", ["left", "right"]),
        Space([Factor(f"agent{agent}", ["listen", "wait", "go"]) for agent in range(agents)]),
        Space([Factor(f"agent{agent}", ["left", "right", "nothing"]) for agent in range(agents)]),
        initial=[Table([state], [0.5, 0.5])],
        transitions=[Table([state, after], [[0.9, 0.1], [0.1, 0.9]])],
        observation=[
            Table([Node("action", agent), after, Node("observation", agent)], hears) for agent in range(agents)
        ],
        utilities=[Table([state, Node("action", 0)], [[0, 0, 1], [0, 0, -1]])],
    )
    return FactoredPOMDP(network, discount=0.9)


MODELS: dict[str, Callable[[int], POMDP]] = {
    "2 states, 2 actions, 2 sounds": doors,
    "2 states, 3 actions, 3 sounds": listeners,
    "fire fighting": lambda agents: mdm.problems.fire_fighting(houses=3, team=agents, discount=0.9),
}


def write(folder: Path, model: POMDP, agents: int, mode: str) -> list[str]:
    """Write a team's file and all that it names; return the agents' names."""
    mdm.save_model(model, folder / "model.npz")
    size, actions = len(model.state_space), len(model.action_space)
    vectors = np.stack([np.linspace(0, 1, size), np.linspace(1, 0, size)])
    mdm.save_policy(AlphaVectors(vectors, [0, actions - 1], actions), folder / "policy.npz")
    (folder / "robot.py").write_text(CODE)
    names = [f"robot{place}" for place in range(agents)]
    with socket.create_server(("127.0.0.1", 0)) as found:
        port = min(found.getsockname()[1], 65000)
    lines = [
        'tasks = ["robot:live"]',
        "[events]",
        "First = {}",
        "Second = {}",
        "Third = {}",
        "[team]",
        'name = "measured"',
    ]
    lines += [f"agents = {json.dumps(names)}", f"port = {port}", f'mode = "{mode}"', "period = 0.5", "lease = 5.0"]
    lines += ["[ensembles.joint]", 'model = "model.npz"', 'policy = "policy.npz"', "[ensembles.joint.observations]"]
    for name, factor in zip(names, model.observation_space.factors, strict=True):
        events = ", ".join(f'"{symbol}" = "{event}"' for symbol, event in zip(factor.names, EVENTS, strict=False))
        lines.append(f'{factor.name} = {{ events = {{ {events} }}, owner = "{name}" }}')
    lines.append("[ensembles.joint.actions]")
    lines += [f'"{symbol}" = "robot:act"' for symbol in model.action_space.factors[0].names]
    (folder / "team.toml").write_text("\n".join(lines) + "\n")
    return names


EVENTS = ("First", "Second", "Third")


def memory(process: int) -> dict[str, float]:
    """Return what a process holds, and held at most, in megabytes."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    lines += Path(f"/proc/{process}/status").read_text().splitlines()
    found = {line.split(":")[0]: line.split()[1] for line in lines if line.endswith(" kB")}
    return {name: int(found[key]) / 1024 for name, key in (("RSS", "Rss"), ("PSS", "Pss"), ("peak", "VmHWM"))}


def processor_time(process: int) -> float:
    """Return the seconds of a processor that a process has taken, its own and the system's for it."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(kind: str, agents: int, mode: str) -> dict[str, Any]:
    """Run a team until each agent has taken some steps; return what the worst of them needed.

    Raises:
        RuntimeError: If one ends before, or takes too long.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        names = write(folder, MODELS[kind](agents), agents, mode)
        began, processes = time.monotonic(), {}
        try:
            for agent in names:
                command = [
                    sys.executable,
                    "-m",
                    "mdm",
                    "run",
                    "team.toml",
                    "--agent",
                    agent,
                    "--decisions",
                    f"{agent}.jsonl",
                ]
                with (folder / f"{agent}.log").open("w") as log:
                    processes[agent] = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)
            first: dict[str, float] = {}
            spent: dict[str, float] = {}
            while True:
                taken = {agent: _lines(folder / f"{agent}.jsonl") for agent in names}
                passed = time.monotonic() - began
                new = [agent for agent in names if taken[agent] and agent not in first]
                first |= dict.fromkeys(new, passed)
                spent |= {agent: processor_time(processes[agent].pid) for agent in new}
                if min(taken.values()) >= STEPS:
                    break
                ended = [agent for agent, process in processes.items() if process.poll() is not None]
                if ended or passed > PATIENCE:
                    said = (folder / f"{(ended or names)[0]}.log").read_text()
                    raise RuntimeError(f"{ended or 'nobody'} has ended after {passed:.0f} s: {said[-2000:]}")
                time.sleep(0.02)
            held = [memory(process.pid) for process in processes.values()]
        finally:
            for process in processes.values():
                process.send_signal(signal.SIGKILL)
                process.wait()
    worst = {f"{key} MB": max(one[key] for one in held) for key in held[0]}
    times = {"first step s": max(first.values()), "processor s": max(spent.values())}
    return {"model": kind, "mode": mode, "agents": agents, **times, **worst}


def _lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def main() -> None:
    """Measure teams of each size, model and mode; print and write."""
    given = parser(__doc__ or "")
    given.add_argument("--agents", type=int, nargs="+", default=[2, 4, 6, 8])
    given.add_argument("--modes", nargs="+", default=["replicated", "centralised", "communicating"])
    given.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    read = given.parse_args()
    if read.quick:
        read.agents, read.modes, read.models = [2], ["replicated"], list(MODELS)[:1]
    compileall.compile_dir(Path(mdm.__file__).parent, quiet=2)
    rows = []
    for kind in read.models:
        for agents in read.agents:
            for mode in read.modes:
                rows.append(measure(kind, agents, mode))
                print(rows[-1], flush=True)
    table(f"The worst of each team's agents, on {os.cpu_count()} cores", rows)
    report("team_memory", {"team_memory": rows}, read.output)


if __name__ == "__main__":
    main()
