"""A system of a TOML file beside ROS, which prints lives, modes, faults, decisions and its end as lines of JSON.

Its argument is the file. A line of its input is JSON: ``{"sense": predicate, "holds": true}``, ``{"occur": event}``,
``{"control": "reset", "ensemble": name}``, ``{"end": true}`` or ``{"echo": 1}``, which is printed back.
"""

import asyncio
import json
import os
import sys
from pathlib import Path

import mdm
from mdm.messages import Control


def tell(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


class Told(mdm.Observer):
    def on_life(self, life):
        tell(life=life.action, status=life.status, number=life.life, detail=life.detail, ensemble=life.ensemble)

    def on_call(self, ensemble, life, action, time):
        tell(life=action, status="succeeded", number=life, detail="", ensemble=ensemble)

    def on_mode(self, mode):
        causes = [{"kind": cause.kind, "detail": cause.detail, "since": cause.since} for cause in mode.causes]
        tell(mode=mode.mode, ensemble=mode.ensemble, causes=causes, time=mode.time)

    def on_fault(self, fault):
        tell(fault=fault.kind, source=fault.source, detail=fault.detail)

    def on_decision(self, decision):
        tell(decision=decision.action_name, cause=decision.cause, ensemble=decision.ensemble)


async def main():
    system = mdm.load_system(Path(sys.argv[1]))
    loop, ended, waiting = asyncio.get_running_loop(), asyncio.Event(), b""

    def read():
        nonlocal waiting
        taken = os.read(sys.stdin.fileno(), 65536)
        if not taken:  # whoever started it is gone
            loop.remove_reader(sys.stdin.fileno())
            ended.set()
        *lines, waiting = (waiting + taken).split(b"\n")
        for line in lines:
            obey(json.loads(line))

    def obey(command):
        if "sense" in command:
            system.predicates.sense(command["sense"], command["holds"])
        elif "occur" in command:
            system.predicates.occur(command["occur"])
        elif "control" in command:
            channel = runtime.channel(f"{command['ensemble']}/control", Control)
            channel.publish(Control(runtime.now(), command["control"]))
        elif "echo" in command:
            tell(echo=command["echo"])
        else:
            ended.set()

    try:
        async with mdm.Runtime(log=None) as runtime:
            runtime.observe(Told())
            loop.add_reader(sys.stdin.fileno(), read)
            await runtime.start(system)
            tell(runs=True)
            await ended.wait()
    finally:
        links = [each for each in system.extensions if hasattr(each, "topics")]
        tell(ended=True, heard={name: topic.heard for link in links for name, topic in link.topics.items()})


mdm.run(main)
