"""One agent of a team as an actor: who is there, who is lost, and how it ends."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import msgspec
import pytest
from hypothesis import example, given, settings, strategies as st
from sentences import refused
from team_robots import Robot, history, over_beliefs, over_states, started
from teams import team as random_team

import mdm
from mdm import problems
from mdm.team.member import Teammates
from mdm.team.ownership import Placement
from mdm.team.sharing.calls import Answers, ask
from mdm.team.team import Team
from mdm.team.transport.network import Network
from mdm.team.transport.session import Session
from mdm.team.transport.settings import Ceiling
from mdm.testing import probe, run_virtual

MODEL = problems.dec_tiger()


def tigers(**options):
    return Team("tigers", ["left", "right"], **options)


def test_a_teammate_that_is_lost_is_a_fault_and_is_told():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        left, right = await started(runtime, tigers(), network, over_beliefs(MODEL))
        told = probe(left.member.channel("teammates", Teammates, retain=True))
        await asyncio.sleep(1.0)
        network.crash("right")
        await asyncio.sleep(1.0)
        assert left.kinds() == ["lost_teammate"]
        assert "agent 'right' of team 'tigers' is lost" in left.faults[0].detail
        assert (told[-1].live, told[-1].lost) == (("left",), ("right",))
        statistics = left.member.statistics()
        assert (statistics.live, statistics.lost) == (("left",), ("right",))
        assert statistics.layers["joint"].members == ("left",)
        assert sum(traffic.messages for traffic in statistics.transport.received.values()) > 0
        await runtime.stop(right.member)
        await Robot(tigers(), "right", network, over_beliefs(MODEL)).start(runtime)
        await asyncio.sleep(1.0)
        assert (told[-1].live, told[-1].lost) == (("left", "right"), ())

    run_virtual(main)


def test_a_teammate_that_was_never_seen_is_told_once():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        left = await Robot(tigers(), "left", network, over_beliefs(MODEL)).start(runtime)
        await asyncio.sleep(60.0)
        assert left.kinds() == ["missing_teammate"]
        assert left.faults[0].detail.startswith("'right' of team 'tigers' was never met: no such agent")

    run_virtual(main)


@pytest.mark.parametrize("options", [{}, {"mode": "centralised"}, {"mode": "communicating", "period": 0.5}])
@pytest.mark.parametrize("older", ["left", "right"])
def test_agents_of_two_versions_of_the_protocol_refuse_each_other_in_one_sentence(options, older):
    class Versions(Network):
        def transport(self, agent, **options):
            made = super().transport(agent, **options)
            made.protocol = 1 if agent == older else 2
            return made

    async def main(runtime):
        network = Versions(runtime.clock, team="tigers")
        robots = await started(runtime, tigers(**options), network, over_beliefs(MODEL))
        await asyncio.sleep(30.0)
        version = mdm.__version__
        there = {"left": f"{version}, protocol 2 at left", "right": f"{version}, protocol 2 at right"}
        there[older] = f"{version} at {older}"
        told = f"right cannot take part in the team: program's version is {there['right']} and {there['left']}"
        for robot in robots:
            assert [fault.detail for fault in robot.faults if fault.kind == "refused"] == [told]
        assert robots[1].ensemble.mode == "stopped"

    run_virtual(main)


@pytest.mark.parametrize(
    ("theirs", "told"),
    [
        ({"mode": "centralised"}, "team's mode is centralised at right and replicated at left"),
        ({"mode": "communicating", "period": 0.5}, "team's mode is communicating at right and replicated at left"),
        ({"agents": ["right", "left"]}, "team's agents is right, left at right and left, right at left"),
        ({"agents": ["right", "extra"]}, "team's agents is right, extra at right and left, right at left"),
    ],
)
@pytest.mark.parametrize("first", [0.0, 20.0])
def test_an_agent_of_another_kind_of_team_is_refused_and_safe(theirs, told, first):
    """Whatever it is that keeps agents from comparing their ensembles."""
    theirs = dict(theirs)
    other = Team("tigers", theirs.pop("agents", ["left", "right"]), **theirs)

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left = Robot(tigers(), "left", network, over_beliefs(MODEL))
        await left.start_alone(runtime)
        await asyncio.sleep(first)
        agent = other.names.index("right")
        build = over_beliefs(MODEL)

        def safe(robot, _):
            return build(robot, agent, safe_action=robot.act("SAFE"))

        right = await Robot(other, "right", network, safe).start(runtime)
        await asyncio.sleep(30.0)
        assert [kind for kind in right.kinds() if kind != "stranger"] == ["refused"]
        assert right.faults[-1].detail == f"right cannot take part in the team: {told}"
        assert right.role == "refused"
        assert right.member.link.refusal == told
        assert [cause.kind for cause in right.ensemble.causes] == ["refused"]
        assert (right.ensemble.mode, right.did) == ("safe", ["SAFE"])
        assert right.commits == []
        assert [kind for kind in left.kinds() if kind != "missing_teammate"] == ["refused"]
        assert left.role == "leading"
        left.observe("hear-left", None)
        await asyncio.sleep(1.0)
        assert left.commits[-1].input == {"left": "hear-left"}
        assert right.commits == []

    run_virtual(main)


@pytest.mark.parametrize("stops", [False, True])
def test_an_agent_that_is_refused_is_safe_until_it_is_not_unless_it_was_told_to_stop(stops):
    """It was stopped without a cause; and one that has said that it is stopped does not move."""
    other = Team("tigers", ["left", "right"], mode="communicating", period=0.5)

    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        left = await Robot(tigers(), "left", network, over_beliefs(MODEL)).start(runtime)
        await asyncio.sleep(20.0)
        build = over_beliefs(MODEL)

        def safe(robot, agent):
            return build(robot, agent, safe_action=robot.act("SAFE"))

        right = await Robot(other, "right", network, safe).start(runtime)
        if stops:
            right.ensemble.stop()
        await asyncio.sleep(10.0)
        assert [cause.kind for cause in right.ensemble.causes] == ["refused"]
        assert (right.ensemble.mode, right.did) == (("stopped", []) if stops else ("safe", ["SAFE"]))
        await runtime.stop(left.member)  # the other one leaves: it is refused no more
        await asyncio.sleep(10.0)
        assert right.ensemble.causes == ()
        assert right.ensemble.mode == ("stopped" if stops else "deciding")
        assert bool(right.did[1:]) is not stops

    run_virtual(main)


@pytest.mark.parametrize("mode", ["replicated", "centralised", "communicating"])
@pytest.mark.parametrize("crash", [True, False])
def test_an_agent_returns_where_its_clock_was_set_back(mode, crash):
    """The number of a life is the time of its start, and a robot without a battery for its clock starts in 1970."""

    async def main(runtime):
        network = Network(runtime.clock, team="tigers", lease=0.5)
        team = tigers(mode=mode, period=0.5)
        network._incarnations["right"] = 10
        left, right = await started(runtime, team, network, over_beliefs(MODEL))
        await asyncio.sleep(3.0)
        if crash:
            network.crash("right")
        await runtime.stop(right.member)
        await asyncio.sleep(2.0)
        for life in (4, 2):
            network._incarnations["right"] = life
            back = await Robot(team, "right", network, over_beliefs(MODEL)).start(runtime)
            await asyncio.sleep(4.0)
            assert back.member.link.live == {"left": 1, "right": life + 1}
            assert left.member.link.live == back.member.link.live
            assert left.commits[-1].missing == ()
            assert back.commits[-1].step == left.commits[-1].step
            back.ensemble.reset()
            await asyncio.sleep(2.0)
            assert any(commit.command is not None for commit in left.commits[-6:])
            await runtime.stop(back.member)
            await asyncio.sleep(1.0)
        assert left.member.link.transport.statistics().dropped.get("stale") is None

    run_virtual(main)


def test_two_that_would_both_decide_for_all_do_not():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        teams = [tigers(mode="centralised", controller=name) for name in ("left", "right")]
        left = await Robot(teams[0], "left", network, over_beliefs(MODEL)).start(runtime)
        right = await Robot(teams[1], "right", network, over_beliefs(MODEL)).start(runtime)
        await asyncio.sleep(2.0)
        assert (left.role, right.role) == ("waiting", "refused")  # of two, neither has met the other
        left.ensemble.start()
        await asyncio.sleep(1.0)
        assert (left.role, right.role) == ("leading", "refused")
        assert right.faults[0].detail.endswith("who decides ensemble 'joint' is right at right and left at left")
        commits = len(right.commits)
        right.observe(None, "hear-left")
        right.ensemble.reset()
        await asyncio.sleep(2.0)
        assert len(right.commits) == commits

    run_virtual(main)


def test_agents_may_have_ensembles_of_their_own():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        team = tigers(mode="centralised")
        left = Robot(team, "left", network, over_beliefs(MODEL))
        left.ensemble, alone = (over_beliefs(MODEL)(left, 0) for _ in range(2))
        alone.name = "alone"
        left.member = team.member("left", left.ensemble, alone, transport=network.transport("left"))
        await left.start(runtime)
        right = await Robot(team, "right", network, over_beliefs(MODEL)).start(runtime)
        await asyncio.sleep(2.0)
        assert (left.role, right.role) == ("leading", "following")
        assert left.kinds() == right.kinds() == []

    run_virtual(main)


def test_of_a_team_the_one_that_differs_is_refused_even_where_its_name_comes_first():
    async def main(runtime):
        network = Network(runtime.clock, team="fire")
        names = ["one", "two", "three"]
        model = random_team(7, agents=3)
        team = Team("fire", names, period=0.5)
        others = [await Robot(team, name, network, over_beliefs(model)).start(runtime) for name in ("two", "three")]
        await asyncio.sleep(1.0)
        odd = Team("fire", names, period=0.5, mode="centralised")
        one = await Robot(odd, "one", network, over_beliefs(model)).start(runtime)
        await asyncio.sleep(3.0)
        assert one.role == "refused"
        assert {robot.role for robot in others} == {"leading", "following"}
        assert all(robot.commits[-1].missing == ("one",) for robot in others)

    run_virtual(main)


def test_what_does_not_fit_is_refused():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        robot = Robot(tigers(), "left", network, over_beliefs(MODEL))
        transport = network.transport("left")
        with refused(mdm.ConfigError):
            tigers().member("middle", robot.ensemble, transport=transport)
        with refused(mdm.ConfigError):
            tigers().member("right", robot.ensemble, transport=transport)
        with refused(mdm.ConfigError):
            tigers().member("left", transport=transport)
        with refused(mdm.ConfigError):
            tigers().member("left", "joint", transport=transport)
        with refused(mdm.ConfigError):
            build = over_beliefs(MODEL)(robot, 0)
            tigers().member("left", build, transport=transport, placement={"other": Placement()})

    run_virtual(main)


def test_a_member_without_a_transport_makes_a_session_with_the_team_s_settings(tmp_path):
    class Nobody:
        act = staticmethod(lambda name: lambda: None)

    certificates = pytest.importorskip("mdm.team.transport.certificates")
    pytest.importorskip("cryptography", reason="makes the certificates")
    files = certificates.make_certificates(tmp_path, {"left": ["127.0.0.1"], "right": ["127.0.0.1"]})
    team = tigers(ceilings=[Ceiling("mdm/tigers/*/joint/belief", rate=5.0)], lease=2.0)
    plain = team.member("right", over_beliefs(MODEL)(Nobody(), 1)).link.transport
    assert isinstance(plain, Session)
    assert plain._settings["listen"]["endpoints"] == ["tcp/127.0.0.1:7448"]
    assert plain._settings["connect"]["endpoints"] == ["tcp/127.0.0.1:7447"]
    assert plain._settings["downsampling"][0]["rules"][0]["freq"] == 5.0
    guarded = team.member("left", over_beliefs(MODEL)(Nobody(), 0), access=files["left"]).link.transport
    assert guarded._settings["listen"]["endpoints"] == ["tls/127.0.0.1:7447"]
    assert guarded._settings["access_control"]["enabled"]
    open_team = Team("tigers", [("left", "tcp/127.0.0.1:7001"), "right"])
    with refused(mdm.ConfigError):
        open_team.member("left", over_beliefs(MODEL)(Nobody(), 0), access=files["left"])


def test_a_member_behind_a_router_is_a_client_that_believes_it(tmp_path):
    class Nobody:
        act = staticmethod(lambda name: lambda: None)

    certificates = pytest.importorskip("mdm.team.transport.certificates")
    pytest.importorskip("cryptography", reason="makes the certificates")
    files = certificates.make_certificates(tmp_path, {"left": []})
    team = Team("tigers", ["left", "right"], router="tls/r.test:7447")
    made = team.member("left", over_beliefs(MODEL)(Nobody(), 0), access=files["left"]).link.transport._settings
    assert (made["mode"], made["listen"]["endpoints"], made["connect"]["endpoints"]) == ("client", [], [team.router])
    assert [one["cert_common_names"] for one in made["access_control"]["subjects"]] == [["router"]]
    with refused(mdm.ConfigError):
        Team("tigers", ["left", "right"], router="tcp/r.test:7447").member(
            "left", over_beliefs(MODEL)(Nobody(), 0), access=files["left"]
        )


@pytest.mark.parametrize(
    "where", [{"router": "tls/r.test:7447"}, {"agents": [("left", "quic/10.0.0.7:7447"), "right"]}]
)
def test_encrypted_endpoints_need_certificates(where):
    class Nobody:
        act = staticmethod(lambda name: lambda: None)

    with refused(mdm.ConfigError):
        Team("tigers", **{"agents": ["left", "right"], **where}).member("right", over_beliefs(MODEL)(Nobody(), 1))


def test_who_asks_is_told_for_how_long_certificates_are_valid():
    async def main(runtime):
        network = Network(runtime.clock, team="tigers")
        robots = await started(runtime, tigers(), network, over_beliefs(MODEL))
        [answers] = [child for child in robots[0].member.children if isinstance(child, Answers)]
        answers._validity = SimpleNamespace(days=5.25)
        asker = network.transport("console")
        await asker.open()
        told = await ask(asker, tigers(), "status")
        assert [one["certificate"] for one in told.values()] == [5.25, None]

    run_virtual(main)


def test_an_ensemble_of_no_team_has_no_lost_teammates():
    async def main(runtime):
        class Nobody:
            act = staticmethod(lambda name: lambda: None)

        ensemble = over_beliefs(MODEL)(Nobody(), 0, on_lost_teammate="hold")
        with refused(mdm.ConfigError):
            await runtime.start(ensemble)

    run_virtual(main)


@pytest.mark.parametrize(("drive", "waits"), [({}, True), ({"period": 0.5}, False)])
def test_a_team_with_a_period_is_told_of_each_step(drive, waits):
    """An event that a step observes is then that of the step before; else nobody counts what went unseen."""

    async def main(runtime):
        with pytest.warns(mdm.ModelWarning, match="as little as 0.5"):
            model = random_team(7, events=True, seen=0.5)
        network = Network(runtime.clock, team="team", lease=0.5)
        team = Team("team", ["left", "right"], **drive)
        robots = await started(runtime, team, network, over_beliefs(model))
        assert [robot.ensemble.controller.model.waits for robot in robots] == [waits, waits]

    run_virtual(main)


EVENTS = st.sampled_from(["crash", "leave", "return", "partition", "heal", "observe", "observe", "reset", "wait"])


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(EVENTS, st.integers(0, 2)), max_size=14), st.booleans(), st.integers(0, 100))
def test_copies_are_the_same_again_whatever_has_happened(events, fixed, seed):
    names = ["left", "right", "third"]
    random_model = random_team(7, agents=3)

    async def main(runtime):
        network = Network(runtime.clock, team="team", lease=0.5, seed=seed, loss=0.1, delay=(0.001, 0.02))
        team = Team("team", names, period=0.5) if fixed else Team("team", names)
        build = over_beliefs(random_model)
        robots = {robot.name: robot for robot in await started(runtime, team, network, build)}
        every, out = list(robots.values()), set()

        async def end(name, *, crash):
            out.add(name)
            if crash:
                network.crash(name)
            await runtime.stop(robots[name].member)

        async def back(name):
            if name in out:
                out.discard(name)
                robots[name] = await Robot(team, name, network, build).start(runtime)
                every.append(robots[name])

        for event, place in events:
            name = names[place]
            if event in {"crash", "leave"} and name not in out:
                await end(name, crash=event == "crash")
            elif event == "return":
                await back(name)
            elif event == "partition":
                network.partition({name}, set(names) - {name})
            elif event == "heal":
                network.heal()
            elif event == "observe" and name not in out:
                robots[name].observe(*(0 if each == place else None for each in range(3)))
            elif event == "reset" and name not in out:
                robots[name].ensemble.reset()
            await asyncio.sleep(0.7)
        network.heal()
        network.loss = 0.0
        for name in names:
            await back(name)
        await asyncio.sleep(8.0)
        assert {robot.role for robot in robots.values()} <= {"leading", "following"}
        robots["left"].observe(1, None, None)
        await asyncio.sleep(2.2)
        steps = {robot.replica.statistics().step for robot in robots.values()}
        digests = {robot.replica.statistics().digest for robot in robots.values()}
        assert len(steps) == len(digests) == 1
        applied = {}
        for robot in every:  # nobody ever applies another input for a step of a term
            for commit in robot.commits:
                known = applied.setdefault((commit.term, commit.step), commit)
                assert (known.input, known.missing, known.command) == (commit.input, commit.missing, commit.command)
                assert known.digest == commit.digest
        for robot in robots.values():
            assert robot.ensemble.mode == "deciding"

    run_virtual(main)


MOVES = st.sampled_from(["crash", "leave", "return", "partition", "heal", "move", "move", "release"])
APART = [
    *(("crash", "a", 0.05), ("return", "a", 0.05), ("heal", "a", 0.3), ("partition", "a", 0.05)),
    *(("crash", "b", 0.05), ("partition", "a", 0.05), ("return", "b", 0.05), ("heal", "a", 0.05)),
    ("partition", "a", 0.9),
]
"""Robot b begins again alone, and is safe since it knows nothing of a's room; then it takes a's copy, which does."""


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.tuples(MOVES, st.sampled_from("ab"), st.sampled_from([0.05, 0.3, 0.9])), max_size=14),
    st.booleans(),
    st.sampled_from(["continue", "hold", "safe_action"]),
    st.integers(0, 100),
)
@example(APART, False, "safe_action", 0)
def test_two_robots_do_what_is_right_for_where_they_are_once_they_see_each_other(events, fixed, reaction, seed):
    async def main(runtime):
        network = Network(runtime.clock, team="rooms", lease=0.5, seed=seed, loss=0.1, delay=(0.001, 0.02))
        team = Team("rooms", ["a", "b"], period=0.5) if fixed else Team("rooms", ["a", "b"])

        def build(robot, agent):
            return over_states(robot, agent, safe_action=robot.act("SAFE"), on_lost_teammate=reaction)

        robots = {robot.name: robot for robot in await started(runtime, team, network, build)}
        lab, out = {"a": False, "b": True}, set()
        for name in "ab":
            robots[name].lab.set(lab[name])

        async def back(name):
            if name in out:
                out.discard(name)
                robots[name] = await Robot(team, name, network, build).start(runtime)
                robots[name].lab.set(lab[name])

        for event, name, pause in events:
            if event in {"crash", "leave"} and name not in out:
                out.add(name)
                if event == "crash":
                    network.crash(name)
                await runtime.stop(robots[name].member)
            elif event == "return":
                await back(name)
            elif event == "partition":
                network.partition({"a"}, {"b"})
            elif event == "heal":
                network.heal()
            elif event == "move" and name not in out:
                lab[name] = not lab[name]
                robots[name].lab.set(lab[name])
            elif event == "release" and name not in out:
                robots[name].ensemble.release()
            await asyncio.sleep(pause)
        network.heal()
        network.loss = 0.0
        await back("a")
        await back("b")
        await asyncio.sleep(8.0)
        assert len({robot.replica.statistics().digest for robot in robots.values()}) == 1
        for name, robot in robots.items():
            assert robot.ensemble.mode == "deciding"
            assert robot.did[-1] == ("go" if lab[name] else "stay")

    run_virtual(main)


JUNK = (b"", b"garbage", bytes(300), *map(msgspec.msgpack.encode, ([], {}, [[1, "left", 2], 3], {"left": 2**60}, -1)))
CHANNELS = (
    *("beat", "leaving", "predicates", "joint/part", "joint/decision", "joint/configuration", "joint/belief"),
    *("joint/agreement", "joint/agreement/all", "joint/agreement/left", "joint/agreement/middle", "no/such/channel"),
)


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_an_agent_that_sends_nothing_but_garbage_does_the_others_no_harm(mode):
    async def main(runtime):
        network = Network(runtime.clock, team="fires")
        team = Team("fires", ["left", "middle", "right"], mode=mode)
        build = over_beliefs(problems.fire_fighting(2, 3, 2))
        left, middle = [await Robot(team, name, network, build).start(runtime) for name in ("left", "middle")]
        bad = network.transport("right")
        await bad.open()
        await asyncio.sleep(1.0)
        for junk in JUNK:
            for channel in CHANNELS:
                bad.put(f"mdm/fires/right/{channel}", junk, priority="step")
            left.observe(0, None, None)
            await bad.ask("mdm/fires/*/joint/status", junk)
            middle.observe(None, 1, None)
            await asyncio.sleep(0.5)
        decided = [commit for commit in left.commits if commit.command is None]
        assert len(decided) >= 2 * len(JUNK)
        assert history(left)[-len(decided) :] == history(middle)[-len(decided) :]
        assert all(commit.missing == ("right",) for commit in decided)
        assert {*left.kinds(), *middle.kinds()} <= {"waiting", "missing_teammate", "incredible"}  # nothing failed

    run_virtual(main)
