from __future__ import annotations

import asyncio
import base64
import gc
import os
import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import msgspec
import pytest
from patience import PATIENCE
from peers import peers
from places import ROOT
from sentences import refused
from transports import LOOPBACK, endpoint, free_port, key, routing

from mdm.errors import ConfigError, Error
from mdm.runtime import VirtualEventLoop
from mdm.team.sharing import calls
from mdm.team.team import Team
from mdm.team.transport import session as module
from mdm.team.transport.router import Packer
from mdm.team.transport.session import Session

pytest.importorskip("zenoh")


async def refusal(**options):
    session = Session("team", "a", **options)
    with pytest.raises(Error) as refused:
        await session.open()
    await session.close()
    return str(refused.value)


def test_a_port_in_use_is_refused_with_the_way_out():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        where = endpoint(taken.getsockname()[1])
        text = asyncio.run(refusal(listen=where))
    assert text == (
        f"agent 'a' of team 'team' cannot listen on {where}: the port is in use; "
        "end the program that has it, or choose another one"
    )


def test_hosts_that_nobody_knows_and_addresses_of_others_are_refused():
    text = asyncio.run(refusal(listen=endpoint(), connect=["tcp/robot.invalid:7447"]))
    assert text == (
        "no host 'robot.invalid' is known, of the endpoint tcp/robot.invalid:7447: "
        "correct it, or give the host's address"
    )
    assert "that is no address of this machine" in asyncio.run(refusal(listen="tcp/192.0.2.1:7447"))


@pytest.mark.parametrize("wrong", ["tcp/127.0.0.1", "127.0.0.1:7447", "tcp/127.0.0.1:0", 7447])
def test_malformed_endpoints_are_refused_at_once(wrong):
    with refused(ConfigError):
        Session("team", "a", listen=endpoint(), connect=[wrong])
    with pytest.raises((ConfigError, TypeError)):
        Session("team", "a", listen=wrong)


def test_names_and_the_lease_are_checked():
    with refused(ConfigError):
        Session("team", "a/b")
    with refused(ConfigError):
        Session("team", "a", lease=0)


def test_a_session_wants_real_time():
    with asyncio.Runner(loop_factory=VirtualEventLoop) as runner:
        assert "Zenoh knows no virtual time" in runner.run(refusal(listen=endpoint()))


def test_a_session_that_is_closed_leaves_no_thread_and_no_file():
    async def main(net):
        await net.open(net.transport("a"), net.transport("b"))

    async def many():
        counts = []
        loop, one_thread = asyncio.get_running_loop(), ThreadPoolExecutor(1)
        for _ in range(6):
            await loop.run_in_executor(one_thread, LOOPBACK, main)
            gc.collect()
            counts.append((len(os.listdir("/proc/self/fd")), threading.active_count()))  # noqa: PTH208
        files, threads = zip(*counts, strict=True)
        # Zenoh's own threads close the last of its files a little later; one a session would be five by now.
        assert files[-1] - files[0] < 3, files
        assert len(set(threads)) == 1, threads

    asyncio.run(many())


def test_who_hangs_while_a_connection_is_opened_does_not_hold_the_end():
    async def main():
        with socket.socket() as hung:
            hung.bind(("127.0.0.1", 0))
            hung.listen()
            session = Session("team", "a", listen=endpoint(), connect=[endpoint(hung.getsockname()[1])])
            before = set(module._open)
            await session.open()
            caller, _ = await asyncio.to_thread(hung.accept)
            with caller:
                await session.close()
                assert module._open == before

    asyncio.run(main())


def test_a_session_listens_on_loopback_unless_told_otherwise():
    assert Session("team", "a")._settings["listen"] == {"endpoints": ["tcp/127.0.0.1:7447"]}


def test_a_step_is_kept_and_the_newest_of_values_while_a_receiver_is_slow():
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        values, steps = [], []
        second.subscribe("mdm/team/a/e/c", lambda sample: values.append(int(sample.body)))
        second.subscribe("mdm/team/a/e/step", lambda sample: steps.append(int(sample.body)))
        await net.open(first, second)
        held = asyncio.get_running_loop().time() + 0.5
        number = 0
        while asyncio.get_running_loop().time() < held:  # the loop is held: nobody takes what comes
            for _ in range(100):
                first.put(key("a"), b"%d" % number)
                number += 1
            first.put(key("a", "step"), b"%d" % (number // 100), priority="step")
            await asyncio.to_thread(lambda: None) if number % 20_000 == 0 else None
        last = number - 1

        def finish():
            first.put(key("a"), b"%d" % last)
            return values and values[-1] == last

        await net.until(finish)
        assert values == sorted(values)
        assert steps == sorted(steps)

    LOOPBACK(main)


def test_garbage_is_dropped_counted_and_reported_and_the_rest_goes_on():
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        reports, got = [], []
        second.supervise(lambda error: None, lambda kind, text: reports.append((kind, text)))
        second.subscribe("mdm/team/**", got.append)
        await net.open(first, second)
        raw = first._zenoh
        for _ in range(24):  # fewer than for which a sender is ignored
            raw.put(key("a"), b"garbage")
            raw.put(key("b"), Packer("a", 1, int).pack(key("b"), b""))
            raw.put(key("a"), Packer("a", 2**62, int, version=2).pack(key("a"), b""))
            raw.put("mdm/team/a/some/where/else", b"")
            raw.delete(key("a"))
        raw.put(key("a"), bytes(10_000_000), congestion_control=_block())
        # What is put while something so large is still on its way may be dropped.
        await net.until(lambda: second.statistics().dropped.get("oversize"))
        first.put(key("a"), b"hello")
        await net.until(lambda: got)
        assert [sample.body for sample in got] == [b"hello"]
        dropped = second.statistics().dropped
        assert dropped == {"malformed": 72, "foreign": 24, "version": 24, "oversize": 1}
        assert sorted(kind for kind, _ in reports[:4]) == ["foreign", "malformed", "oversize", "version"]

    LOOPBACK(main)


def _block():
    import zenoh

    return zenoh.CongestionControl.BLOCK


def test_an_answer_under_the_key_of_another_is_dropped():
    async def main(net):
        first, second = net.transport("a"), net.transport("b")
        first.serve(key("a", "call"), lambda body: b"mine")
        await net.open(first, second)
        first.packer = Packer("b", 1, int)
        assert await second.ask(key("a", "call")) == {}
        assert second.statistics().dropped == {"foreign": 1}

    LOOPBACK(main)


def test_of_two_of_one_name_that_begin_at_once_one_stays_and_both_are_told():
    async def main(net):
        other = net.transport("b")
        await other.open()
        seen = []
        other.watch(seen.append)
        pair = [net.transport("a", lease=0.3) for _ in range(2)]
        ends = await asyncio.gather(*(session.open() for session in pair), return_exceptions=True)
        refused = [end for end in ends if end is not None]
        assert len(refused) == 1
        assert "an agent 'a' of team 'team' is live already" in str(refused[0])
        stays = pair[ends.index(None)]
        await net.until(lambda: seen[-1].get("a") == stays.incarnation)
        assert stays.statistics().dropped["duplicate"] >= 1

    LOOPBACK(main)


def test_what_is_over_the_allowance_is_held_back_and_counted():
    from mdm.team.transport.allowance import Allowance

    async def main(net):
        first, second = net.transport("a", allowance=Allowance(messages=1, burst=5)), net.transport("b")
        got = []
        second.subscribe("mdm/team/**", lambda sample: got.append(sample.body))
        await net.open(first, second)
        taken = [first.put(key("a"), b"value") for _ in range(20)]
        assert taken.count(True) in {5, 6}
        assert first.put(key("a", "step"), b"step", priority="step")
        await net.until(lambda: b"step" in got)
        assert first.statistics().dropped == {"held_back": taken.count(False)}
        assert second.statistics().dropped == {}

    LOOPBACK(main)


def test_other_event_loops_will_do():
    uvloop = pytest.importorskip("uvloop")

    async def main():
        one, other = endpoint(), endpoint()
        first = Session("team", "a", listen=one)
        second = Session("team", "b", listen=other, connect=[one])
        got, seen = [], []
        second.subscribe("mdm/team/a/**", lambda sample: got.append(sample.body))
        second.serve(key("b", "call"), lambda body: body)
        first.watch(lambda live: seen.append(1) if "b" in live else None)
        await first.open()
        await second.open()
        async with asyncio.timeout(PATIENCE):
            while not seen:
                await asyncio.sleep(0.002)
            for _ in range(100):
                first.put(key("a"), b"hello")
            while len(got) < 100:
                await asyncio.sleep(0.002)
        assert await first.ask(key("b", "call"), b"you?", timeout=PATIENCE) == {"b": b"you?"}
        await first.close()
        await second.close()

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())


def over_processes(test):
    async def main():
        async with peers() as start:
            await test(start)

    asyncio.run(main())


def test_who_is_seen_is_reached_by_the_first_message_between_processes():
    async def test(start):
        one, two = endpoint(), endpoint()
        for first_listen, second_listen in ((one, two), (two, one)):
            a = await start(agent="a", listen=first_listen, hello=key("a"), subscribe=["mdm/team/b/**"])
            b = await start(
                agent="b", listen=second_listen, connect=[first_listen], hello=key("b"), subscribe=["mdm/team/a/**"]
            )
            assert (await a.hear("body"))["body"] == "a"
            assert (await b.hear("body"))["body"] == "b"
            for peer in (a, b):
                peer.signal(signal.SIGKILL)
                await peer.end()

    over_processes(test)


def test_a_killed_peer_is_told_of_and_returns_under_its_name_and_port():
    async def test(start):
        where = endpoint()
        a = await start(agent="a", listen=where)
        await a.hear("opened")
        own = endpoint()
        for _ in range(2):
            b = await start(agent="b", listen=own, connect=[where])
            incarnation = (await b.hear("opened"))["opened"]
            seen = await a.hear("live", where=lambda event: "b" in event["live"])
            assert seen["live"]["b"] == incarnation
            b.signal(signal.SIGKILL)
            await a.hear("live", where=lambda event: "b" not in event["live"])

    over_processes(test)


def test_a_stopped_peer_is_told_of_by_its_lease_and_comes_back():
    async def test(start):
        where = endpoint()
        a = await start(agent="a", listen=where)
        b = await start(agent="b", listen=endpoint(), connect=[where])
        await a.hear("live", where=lambda event: "b" in event["live"])
        b.signal(signal.SIGSTOP)
        await a.hear("live", where=lambda event: "b" not in event["live"])
        b.signal(signal.SIGCONT)
        await a.hear("live", where=lambda event: "b" in event["live"])

    over_processes(test)


def test_a_second_process_of_a_name_is_refused_and_the_first_goes_on():
    async def test(start):
        where = endpoint()
        a = await start(agent="a", listen=where, subscribe=["mdm/team/b/**"])
        b = await start(agent="b", listen=endpoint(), connect=[where])
        await a.hear("live", where=lambda event: "b" in event["live"])
        again = await start(agent="b", listen=endpoint(), connect=[where])
        refused = await again.hear("refused", "opened")
        assert refused == {
            "refused": "an agent 'b' of team 'team' is live already: end its process, or give this one another name"
        }
        assert await again.end() == 0
        b.tell(put=key("b"), body="still here")
        assert (await a.hear("body"))["body"] == "still here"

    over_processes(test)


@pytest.mark.parametrize("ending", ["end", "close"])
def test_a_program_ends_whether_or_not_it_closes(ending):
    async def test(start):
        where = endpoint()
        a = await start(agent="a", listen=where, subscribe=["mdm/team/b/**"])
        b = await start(agent="b", listen=endpoint(), connect=[where], subscribe=["mdm/team/a/**"])
        await a.hear("live", where=lambda event: "b" in event["live"])
        b.tell(**{ending: True, "end": True})
        await b.hear("ends")
        assert await b.end() == 0
        await a.hear("live", where=lambda event: "b" not in event["live"])

    over_processes(test)


def test_forged_messages_of_a_process_reach_no_handler():
    async def test(start):
        where = endpoint()
        a = await start(agent="a", listen=where, subscribe=["mdm/team/b/**", "mdm/team/c/**"])
        b = await start(agent="b", listen=endpoint(), connect=[where])
        await a.hear("live", where=lambda event: "b" in event["live"])
        forged = Packer("b", 1, int).pack(key("c"), b"I am c")
        b.tell(forge=key("c"), data=base64.b64encode(forged).decode())
        assert (await a.hear("dropped"))["dropped"] == "foreign"
        b.tell(put=key("b"), body="I am b")
        await a.hear("body")
        assert [event["body"] for event in a.heard if "body" in event] == ["I am b"]

    over_processes(test)


PROGRAMS = {
    "fork": """
        session = Session("team", "a", listen=sys.argv[1])
        await session.open()
        warnings.simplefilter("ignore")  # from 3.12 on Python warns of every fork beside threads
        if os.fork() == 0:
            status = 0
            for use in (lambda: session.put("mdm/team/a/e/c", b""), lambda: Session("team", "b").open().send(None)):
                try:
                    use()
                except Error as error:
                    status += "forked from one with an open session" in str(error)
            sys.exit(status)
        print(os.waitstatus_to_exitcode(os.wait()[1]))
        await session.close()
    """,
    "raise": """
        session = Session("team", "a", listen=sys.argv[1])
        session.subscribe("mdm/team/**", print)
        await session.open()
        raise RuntimeError("forgot to close")
    """,
    "import": """
        print("zenoh" in sys.modules)
        import mdm
        print("zenoh" in sys.modules, "mdm.team" in sys.modules)
    """,
    "absent": """
        sys.modules["zenoh"] = None
        try:
            await Session("team", "a", listen=sys.argv[1]).open()
        except Error as error:
            print(error)
    """,
}


def run(name, *, at=None):
    body = PROGRAMS[name]
    program = (
        "import asyncio, os, sys, warnings\nfrom mdm.errors import Error\n"
        "from mdm.team.transport.session import Session\n"
        f"async def main():\n{body}\nasyncio.run(main())"
    )
    return subprocess.run(
        [sys.executable, "-c", program, endpoint()], capture_output=True, text=True, timeout=PATIENCE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def test_a_forked_child_is_told_so_and_ends():
    ended = run("fork")
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "2\n", "")


def test_a_program_that_raises_ends():
    ended = run("raise")
    assert ended.returncode == 1
    assert "forgot to close" in ended.stderr


def test_zenoh_is_loaded_by_those_alone_who_open_a_session():
    assert run("import").stdout == "False\nFalse True\n"


def test_without_zenoh_it_is_said_how_to_install_it():
    ended = run("absent")
    assert ended.stdout == (
        "processes of a team talk through Zenoh, which is not installed: pip install eclipse-zenoh\n"
    ), ended.stderr


def test_opening_that_is_cancelled_leaves_nothing_open():
    async def main():
        where = endpoint(free_port())
        session = Session("team", "a", listen=where, connect=[endpoint()])  # nobody is there: that takes a while
        opening = asyncio.ensure_future(session.open())
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        await session.close()
        async with asyncio.timeout(PATIENCE):
            while True:
                again = Session("team", "a", listen=where)
                try:
                    await again.open()
                    break
                except Error as error:
                    assert "in use" in str(error)
        await again.close()

    asyncio.run(main())


@pytest.mark.parametrize(("host", "told"), [("127.0.0.1", 0), ("0.0.0.0", 1)])
def test_an_endpoint_that_everybody_reaches_is_told_once(host, told):
    async def main(net):
        reports = []
        session = net.transport("a", listen=f"tcp/{host}:{free_port()}")
        session.supervise(pytest.fail, lambda kind, reason: reports.append((kind, reason)))
        await session.open()
        assert [kind for kind, _ in reports] == ["unprotected"] * told
        assert all("can speak as any agent of the team" in reason for _, reason in reports)
        assert session.statistics().dropped == {}

    LOOPBACK(main)


def test_a_client_waits_for_its_router_and_finds_it_again():
    async def main(net):
        where = endpoint()
        a, b = (net.transport(agent, listen=[], connect=[where], mode="client") for agent in "ab")
        opening = [asyncio.create_task(session.open()) for session in (a, b)]
        tried, begin = asyncio.Event(), a._begin

        def once():
            try:
                return begin()
            finally:
                loop.call_soon_threadsafe(tried.set)

        loop, a._begin = asyncio.get_running_loop(), once
        await asyncio.wait_for(tried.wait(), PATIENCE)
        assert not any(one.done() for one in opening)
        with routing(where):
            await asyncio.gather(*opening)
            await net.until(lambda: "b" in a._tokens)
        await net.until(lambda: "b" not in a._tokens)
        with routing(where):
            await net.until(lambda: "b" in a._tokens and "a" in b._tokens)

    LOOPBACK(main)


def test_a_client_that_waits_for_its_router_can_end():
    async def main(net):
        session = net.transport("a", listen=[], connect=[endpoint()], mode="client")
        opening = asyncio.create_task(session.open())
        while session.state == "new":
            await asyncio.sleep(0)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening

    LOOPBACK(main)  # which waits for the session's thread


@pytest.mark.parametrize(("host", "told"), [("127.0.0.1", 0), ("localhost.localdomain", 1)])
def test_a_router_that_everybody_reaches_is_told_once(host, told, monkeypatch):
    monkeypatch.setattr(module, "resolve", lambda endpoint: None)

    async def main(net):
        port, reports = free_port(), []
        session = net.transport("a", listen=[], connect=[f"tcp/{host}:{port}"], mode="client")
        session.supervise(pytest.fail, lambda kind, reason: reports.append(kind))
        session._settings["connect"]["endpoints"] = [endpoint(port)]
        with routing(endpoint(port)):
            await session.open()
            assert reports == ["unprotected"] * told

    LOOPBACK(main)


def test_who_asks_a_team_whose_router_is_not_there_is_told(monkeypatch):
    monkeypatch.setattr(calls, "_OPENING", 0.1)
    where = endpoint()

    async def main():
        with pytest.raises(Error) as refused:
            async with calls.asking(Team("team", ["a", "b"], router=where)):
                raise AssertionError
        return str(refused.value)

    assert asyncio.run(main()) == f"no router answers at {where}: start it, or correct the team's `router`"


def test_who_it_is_is_told_with_an_address_behind_a_router_too():
    where = endpoint()
    behind = Session("team", "a", listen=[], connect=[where], mode="client")
    for session in (Session("team", "a", listen=where), behind):
        assert msgspec.msgpack.decode(session.identity) == ["a", session.incarnation, where]
