"""A program with a wire over rclpy, which does what it is told by lines of JSON, and prints what it hears.

Its argument is JSON: what the wire is made of, and ``topics``, ``publishers``, ``clients``, ``services``, ``actions``,
each by name, with its type; then `mdm.ros2.wire.Quality` of topics. ``raises``: topics of which each message raises.
"""

import asyncio
import json
import sys
import threading
import time
from pathlib import Path

import rclpy

import mdm
from mdm.ros2.messages import plain
from mdm.ros2.rclpy_wire import RclpyWire
from mdm.ros2.wire import Quality


def tell(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def held(file):
    """Do nothing until there is a file."""
    while not file.exists():
        time.sleep(0.01)


class Obey:
    def __init__(self, options):
        self.wire = RclpyWire(options.get("node", "ours"), options.get("namespace", ""), options.get("remap"))
        self.raises, self.hangs = options.get("raises", ()), options.get("hangs", ())
        quality = Quality(**options.get("quality", {}))
        for topic, kind in options.get("topics", {}).items():
            self.wire.subscribe(topic, kind, lambda message, topic=topic: self.heard(topic, message), quality)
        for service, kind in options.get("services", {}).items():
            self.wire.serve(service, kind, self.answer)
        self.publishers = {
            name: self.wire.publish(name, kind, quality) for name, kind in options.get("publishers", {}).items()
        }
        self.clients = {name: self.wire.call(name, kind) for name, kind in options.get("clients", {}).items()}
        self.actions = {name: self.wire.action(name, kind) for name, kind in options.get("actions", {}).items()}
        self.goals, self.tasks = {}, {}

    def heard(self, topic, message):
        if topic in self.raises:
            raise ValueError("a sensor's mistake")
        if topic in self.hangs:
            tell(hangs=topic)
            time.sleep(1000)
        tell(heard=topic, message=plain(message), thread=threading.current_thread() is not threading.main_thread())

    def answer(self, request):
        tell(asked=plain(request), thread=threading.current_thread() is not threading.main_thread())
        return {"success": True, "message": "done"} if plain(request).get("data", True) else 1 / 0

    async def obey(self, command):
        try:
            await getattr(self, next(iter(command)))(**command)
        except Exception as error:
            tell(error=f"{type(error).__name__}: {error}")

    async def publish(self, publish, message, made=None):
        if made is not None:  # by somebody who sets what he likes
            ready = self.wire.make(made, {})
            for path, value in message.items():
                target, *rest = path.split(".")
                thing = ready
                while rest:
                    thing, target, *rest = getattr(thing, target), *rest
                setattr(thing, target, value)
            message = ready
        self.publishers[publish](message)
        tell(published=publish)

    async def matched(self, matched):
        while not self.publishers[matched].ready:
            await asyncio.sleep(0.01)
        tell(matched=matched)

    async def ready(self, ready):
        client = self.clients.get(ready) or self.actions[ready]
        while not client.ready:
            await asyncio.sleep(0.01)
        tell(ready=ready)

    async def call(self, call, request):
        tell(response=plain(await self.clients[call](request)))

    async def send(self, send, goal, number, shielded=True):
        sent = self.goals[number] = self.actions[send].send(
            goal,
            lambda message: tell(feedback=plain(message), of=number),
            lambda code: tell(status=code, of=number),
        )
        self.tasks[number] = asyncio.current_task()
        try:
            accepted = await sent.accepted()
        except asyncio.CancelledError:
            tell(gave_up=number)
            accepted = await sent.accepted()
        tell(accepted=accepted, of=number)
        if accepted:
            await self.end(number)

    async def give_up(self, give_up):
        self.tasks[give_up].cancel()

    async def end(self, end):
        try:
            status, result = await self.goals[end].end()
        except asyncio.CancelledError:
            tell(gave_up=end)
            status, result = await self.goals[end].end()
        tell(ended=end, status=status, result=plain(result))

    async def cancel(self, cancel):
        tell(code=await self.goals[cancel].cancel(), of=cancel)

    async def peers(self, peers, role, wanted):
        """Print when the graph says these: it hears of names later than of topics."""
        found = None
        while found != wanted:
            await asyncio.sleep(0.01)
            told = self.wire.peers(role, peers)
            found = [[each.node, each.kind, each.quality and each.quality.reliability] for each in told]
        tell(peers=found)

    async def threads(self, threads):
        tell(threads=[each.name for each in threading.enumerate()])

    async def hold(self, hold):
        """Hold the event loop until there is a file."""
        tell(holds=True)
        held(Path(hold))

    async def shut(self, shut):
        rclpy.shutdown(context=self.wire.node.context)
        tell(shut=True)

    async def close(self, close):
        begin = time.monotonic()
        await self.wire.close()
        tell(closed=time.monotonic() - begin)


class Linked(mdm.Extension):
    patience = 2.0

    def __init__(self, wire):
        self.wire = wire

    async def open(self, runtime):
        await self.wire.open(runtime)

    async def close(self):
        await self.wire.close()


async def main():
    try:
        obeys = Obey(json.loads(sys.argv[1]))
        async with mdm.Runtime(log=None, extensions=[Linked(obeys.wire)]) as runtime:
            runtime.faults.subscribe(lambda fault: tell(fault=fault.source, kind=fault.kind, detail=fault.detail))
            tell(opened=True, handlers=rclpy.signals.get_current_signal_handlers_options().name)
            loop, tasks = asyncio.get_running_loop(), set()
            lines = asyncio.StreamReader()
            await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
            async for line in lines:
                task = loop.create_task(obeys.obey(json.loads(line)))
                tasks.add(task)
        tell(over=True)
    except mdm.Error as error:
        tell(refused=str(error), threads=[each.name for each in threading.enumerate()])


asyncio.run(main())
