"""Running teams over real sessions, and bad input: it is refused, told of and counted, and the team goes on."""

from __future__ import annotations

import asyncio
import random
import socket
from itertools import pairwise

import pytest
from patience import PATIENCE
from team_robots import Robot, over_beliefs, started
from teams import team as random_team
from transports import LOOPBACK, Stranger, endpoint, two_days_ago

import mdm
from mdm.runtime import ActorFailure
from mdm.team import member
from mdm.team.team import Team
from mdm.team.transport import access
from mdm.team.transport.access import access_settings
from mdm.team.transport.certificates import make_certificates
from mdm.team.transport.keys import matches
from mdm.team.transport.router import VERSION, Packer

pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")

BUSY = {"lost_teammate", "lost_majority", "waiting", "stale"}
"""What agents may tell of where the machine is busy."""

SIZES = [*range(48), 100, 1000, 4096, 65_535, 65_536, 200_000]


def shares(names):
    """What each agent exports, and imports of the others."""
    return lambda name: {"exports": ["joint/belief"], "imports": [f"{o}/joint/belief" for o in names if o != name]}


class Running:
    """A team that decides."""

    def __init__(self, team, build, robots, net):
        self.team, self.build, self.robots, self.net = team, build, robots, net

    async def decide(self, count=10):
        """Wait until each agent has decided so many times more."""
        wanted = [(robot, len(robot.commits) + count) for robot in self.robots]
        await self.net.until(lambda: all(len(robot.commits) >= more for robot, more in wanted))

    def keys(self):
        """Return every key that is put, subscribed or answered in the team."""
        found = set()
        for robot in self.robots:
            found.update(robot.transport.statistics().sent, robot.transport.served())
            for expression in robot.transport.carriers():
                found.update(expression.replace("*", name) for name in self.team.names)
        return sorted(found)

    def dropped(self, kind):
        """Return how many each agent has dropped."""
        return [robot.transport.statistics().dropped.get(kind, 0) for robot in self.robots]

    def garbage(self):
        """Return how many messages each agent has dropped that cannot be, read or unread."""
        return [sum(both) for both in zip(self.dropped("malformed"), self.dropped("ignored"), strict=True)]

    async def drop(self, **counts):
        """Wait until each agent has dropped so many of these kinds, and has told of them."""
        for kind, count in counts.items():
            await self.net.until(lambda kind=kind, count=count: min(self.dropped(kind)) >= count)
            await self.net.until(lambda kind=kind: all(kind in robot.kinds() for robot in self.robots))

    async def come(self, name, condition, **options):
        """Have one more process be an agent of the team until a condition of its robot holds; return the robot."""
        async with mdm.Runtime(log=None) as runtime:
            robot = Robot(self.team, name, Late(self.net, options), self.build)
            await robot.start(runtime)
            await self.net.until(lambda: condition(robot))
            return robot

    async def refuse(self, name, **options):
        """Have one more process be an agent of the team; return why it fails."""
        with pytest.raises(ActorFailure) as failed:
            await self.come(name, lambda robot: False, **options)
        return str(failed.value)


def check(robot, *told):
    """An agent has told of these and of nothing else, of none more than once a second, and goes on."""
    assert robot.member.life == "running"
    assert set(robot.kinds()) - BUSY == set(told), robot.faults
    for kind in told:
        times = [fault.time for fault in robot.faults if fault.kind == kind]
        assert all(later - earlier > 900_000_000 for earlier, later in pairwise(times))


class Late:
    """The network of a team, for one who comes with options of his own."""

    def __init__(self, net, options):
        self.net, self.options = net, options

    def transport(self, name):
        return self.net.transport(name, **self.options)


@pytest.fixture
def hurried(monkeypatch):
    """Have who misses a teammate say so soon."""
    monkeypatch.setattr(member, "_PATIENCE", 0.5)


def over_sessions(test, *, names="abc", mode="replicated", present=None, **options):
    """Run a test on a team that decides at a fixed rate, all in this process."""
    # A communicating team begins a lease after its start.
    lease = 1.0 if mode != "communicating" else 0.5

    async def run(net):
        async with mdm.Runtime(log=None) as runtime:
            team = Team("team", list(names), mode=mode, period=0.05, lease=lease)
            build = over_beliefs(random_team(7, agents=len(names)))
            robots = await started(runtime, team, net, build, names=present, member=shares(names))
            running = Running(team, build, robots, net)
            await running.decide()
            await test(running)
            await running.decide()
            if mode == "replicated":
                agreed(running.robots)

    LOOPBACK(run, agents=list(names), **options)


def agreed(robots):
    """No two agents have applied another step for one (term, step)."""
    known = {}
    for robot in robots:
        for commit in robot.commits:
            what = commit.input, commit.missing, commit.action, commit.digest
            assert known.setdefault((commit.term, commit.step), what) == what


@pytest.mark.parametrize(("mode", "names"), [("replicated", "abc"), ("centralised", "ab"), ("communicating", "ab")])
def test_garbage_on_every_key_harms_no_team(mode, names):
    chance = random.Random(1)

    async def test(running):
        async with Stranger(running.net.endpoints) as stranger:
            await stranger.reach(running.robots)
            keys, before = running.keys(), running.garbage()

            def flood():
                for size in SIZES:
                    for key in keys:
                        stranger.put(key, chance.randbytes(size))
                for key in keys:
                    stranger.ask(key, chance.randbytes(100))

            await asyncio.to_thread(flood)
            await running.decide()
            for agent in names:
                stranger.live(f"mdm/team/{agent}/@team/live/x")
            count = len(names)
            kinds = ("oversize", "version", "foreign")
            async with asyncio.timeout(PATIENCE):
                while any(min(running.dropped(kind)) < count for kind in kinds):
                    await asyncio.sleep(0.3)  # those whom the flood had ignored are heard again, once it is over
                    for agent in names:
                        key = f"mdm/team/{agent}/beat"
                        stranger.put(key, bytes(10_000_000))
                        stranger.put(key, Packer(agent, 2**62, int, version=VERSION + 1).pack(key, b""))
                        stranger.put(key, Packer("x", 2**62, int).pack(key, b""))
            await running.drop(oversize=count, version=count, foreign=count)
            for robot, old, new in zip(running.robots, before, running.garbage(), strict=True):
                router = robot.transport
                taken = [key for key in keys if any(matches(wide, key) for wide in router.carriers())]
                assert new - old >= len(SIZES) * len(taken) + len([*router.served()])
                lost = {"missing"} & set(robot.kinds())  # of what it did not read
                check(robot, "malformed", "oversize", "version", "foreign", "ignored", *lost)

    over_sessions(test, names=names, mode=mode)


def test_who_has_a_wrong_name_port_or_endpoint_is_told_so_and_the_team_goes_on(hurried):
    async def test(running):
        a, b = running.robots
        nowhere = asyncio.create_task(
            running.come("c", lambda robot: "missing_teammate" in robot.kinds(), connect=[endpoint()])
        )
        assert (await running.refuse("b")).endswith(
            "an agent 'b' of team 'team' is live already: end its process, or give this one another name"
        )
        told = {fault.detail for fault in b.faults if fault.kind == "duplicate"}
        assert "another process asks as agent 'b': two have this name" in told
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            used = endpoint(taken.getsockname()[1])
            assert f"cannot listen on {used}: the port is in use" in await running.refuse("c", listen=used)
        running.net.endpoints.remove(used)
        await running.decide()
        stranger = running.net.transport("x")
        await stranger.open()
        await running.net.until(
            lambda: stranger.put("mdm/team/x/beat", b"\x80") and "stranger" in a.kinds() and "stranger" in b.kinds()
        )
        lonely = await nowhere
        assert "'a' and 'b' of team 'team' were never met" in lonely.faults[-1].detail
        assert lonely.did == []
        assert running.dropped("duplicate")[1] >= 1
        check(a, "stranger", "missing_teammate", "duplicate")
        check(b, "stranger", "missing_teammate", "duplicate")

    over_sessions(test, present="ab", lease=0.5)


def test_wrong_certificates_and_forged_keys_harm_no_team_with_access(tmp_path, monkeypatch, hurried):
    pytest.importorskip("cryptography", reason="makes the certificates")
    hosts = {agent: ["127.0.0.1"] for agent in "abc"}
    with monkeypatch.context() as patch:  # one authority for both
        from cryptography.hazmat.primitives.asymmetric import ec

        key = ec.generate_private_key(ec.SECP256R1())
        patch.setattr(ec, "generate_private_key", lambda curve: key)
        files = make_certificates(tmp_path / "team", hosts)
        with two_days_ago():
            expired = make_certificates(tmp_path / "expired", hosts, days=1)
    others = make_certificates(tmp_path / "others", hosts)

    async def test(running):
        # They would be refused at their own agents.
        monkeypatch.setattr(access, "_check_certificate", lambda *_: None)
        wrong = {
            "another authority": others["c"],
            "a time that is over": expired["c"],
            "another name": files["b"],
        }
        there = list(running.net.endpoints)
        coming = [
            asyncio.create_task(
                running.come("c", lambda robot: "missing_teammate" in robot.kinds(), shown=shown, connect=there)
            )
            for shown in wrong.values()
        ]
        configuration = access_settings(files["c"], "team", "c", "abc")
        async with Stranger(there, configuration) as stranger:
            await stranger.reach(running.robots, "c")
            forged = "mdm/team/b/beat"
            stranger.live("mdm/team/b/@team/live/7")
            stranger.put(forged, b"garbage")
            stranger.put(forged, Packer("b", 2**62, int).pack(forged, b""))
            stranger.put("mdm/team/c/beat", bytes(10_000_000))
            await running.drop(oversize=1)
            await running.decide()
        for lonely in await asyncio.gather(*coming):
            assert "the authority of its certificate" in lonely.faults[-1].detail
        for robot in running.robots:
            assert robot.transport.statistics().dropped.keys() == {"malformed", "oversize"}
            assert robot.member.link.live.keys() == {"a", "b"}
            check(robot, "malformed", "oversize", "missing_teammate")

    over_sessions(test, present="ab", files=files)
