"""An agent in a process of its own: does what lines on standard input say, and prints what it sees, as JSON."""

from __future__ import annotations

import asyncio
import base64
import json
import sys

from mdm.team.transport.session import Session


def tell(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


async def commands():
    """Yield the lines of standard input."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        yield json.loads(line)


async def main():
    options = json.loads(sys.argv[1])
    for_open = options.pop("subscribe", [])
    hello = options.pop("hello", None)
    session = Session(**options)
    for expression in for_open:
        session.subscribe(
            expression, lambda sample: tell(key=sample.key, owner=sample.owner, body=sample.body.decode())
        )
    known = set()

    def greet(live):
        tell(live=live)
        for agent in live.keys() - known - {session.agent} if hello else ():
            session.put(hello, agent.encode())
        known.clear()
        known.update(live)

    session.watch(greet)
    session.supervise(lambda error: tell(failed=repr(error)), lambda kind, text: tell(dropped=kind, text=text))
    session.serve(f"mdm/{session.team}/{session.agent}/e/echo", lambda body: body)
    try:
        await session.open()
    except Exception as error:
        tell(refused=str(error))
        return
    tell(opened=session.incarnation)
    async for command in commands():
        if "put" in command:
            tell(put=session.put(command["put"], command["body"].encode(), priority=command.get("priority", "value")))
        if "forge" in command:
            session._zenoh.put(command["forge"], base64.b64decode(command["data"]))
            tell(forged=True)
        if "close" in command:
            await session.close()
            tell(closed=True)
        if "end" in command:
            break
    # what follows depends on who calls: a program that forgets to close must end all the same


if __name__ == "__main__":
    asyncio.run(main())
    tell(ends=True)
