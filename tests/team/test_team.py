"""What a team is told, and refuses."""

from __future__ import annotations

import subprocess
import sys

import pytest
from sentences import refused

import mdm
from mdm.team.team import Agent, Team
from mdm.team.transport.settings import Ceiling


def test_a_team_knows_its_agents_and_how_they_decide():
    team = Team("rescue", ["robot1", ("robot2", "tcp/10.0.0.2:7450")], period=0.5)
    assert team.agents == (Agent("robot1"), Agent("robot2", "tcp/10.0.0.2:7450"))
    assert team.names == ("robot1", "robot2")
    assert (team.mode, team.quorum, team.deadline) == ("replicated", "continue", 0.25)
    assert not team.event_driven
    assert repr(team) == "<Team 'rescue': replicated, robot1, robot2>"


def test_three_agents_need_a_majority_unless_told_otherwise():
    assert Team("t", ["a", "b", "c"]).quorum == "majority"
    assert Team("t", ["a", "b", "c"], quorum="continue").quorum == "continue"
    assert Team("t", ["a", "b"], quorum="majority").quorum == "majority"


def test_drives():
    assert Team("t", ["a"]).event_driven
    assert Team("t", ["a"], drive="event").event_driven
    assert Team("t", ["a"], drive=4.0).period == 0.25
    assert Team("t", ["a"], drive=mdm.FixedRate(2.0)).deadline == 0.25


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"name": "a/b"}, "the name of a team has '/'"),
        ({"agents": "robot1"}, "agents are a list of names"),
        ({"agents": []}, "at least one agent"),
        ({"agents": ["a", "a"]}, "two agents are called 'a'"),
        ({"agents": ["a", "b*"]}, "the name of an agent has"),
        ({"agents": [("a", "tcp/h:1"), ("b", "tcp/h:1")]}, "'a' and 'b' are both reached at tcp/h:1"),
        ({"agents": [("a", "tcp/localhost:1"), ("b", "ws/127.0.0.1:1")]}, "are both reached at ws/127.0.0.1:1"),
        ({"agents": [Agent("a", connect="tcp/h:1", listen="tcp/i:1"), ("b", "tcp/H:1?x")]}, "are both reached"),
        ({"agents": [Agent("a", listen="nowhere", connect="tcp/h:1")]}, "an endpoint is a protocol, a host and a port"),
        ({"router": "tcp/r:7447", "agents": [("a", "tcp/h:1")]}, "agents with a router listen nowhere"),
        ({"router": "nowhere"}, "an endpoint is a protocol, a host and a port"),
        ({"agents": [("a", "nowhere")]}, "an endpoint is a protocol, a host and a port"),
        ({"mode": "anarchy"}, "team.mode: 'anarchy' is not one of 'replicated', 'centralised', 'communicating'"),
        ({"quorum": "all"}, "team.quorum: 'all' is not one of 'majority', 'continue'"),
        ({"period": 0}, "team.period: a number of seconds above 0 and"),
        ({"period": 1.0, "drive": "event"}, "a period or a drive, not both"),
        ({"drive": "sometimes"}, "a drive is"),
        ({"period": 1.0, "deadline": 2.0}, "the next begins after 1 s"),
        ({"lease": -1}, "team.lease: a number of seconds above 0 and at most 1,000,000,000 was expected"),
        ({"max_age": "long"}, "team.max_age: a number of seconds above 0 and at most 1,000,000,000 was expected"),
        ({"ceilings": [Ceiling("mdm/**")]}, "ceilings"),
        ({"controller": "a"}, "a controller is for centralised teams"),
        ({"controller": "c", "mode": "centralised"}, "has no agent 'c'"),
        ({"mode": "centralised", "deadline": 0.2}, "decides on each as it comes, and waits for nothing"),
    ],
)
def test_what_means_nothing_is_refused(given, words):
    options = {"name": "team", "agents": ["a", "b"]} | given
    with pytest.raises(mdm.ConfigError, match=words):
        Team(options.pop("name"), options.pop("agents"), **options)


@pytest.mark.parametrize("host", ["0.0.0.0", "[::]", "0", "0x0.0", "[0:0::0]", "[::ffff:0.0.0.0]"])
@pytest.mark.parametrize("given", ["endpoint", "connect", "router"])
def test_nobody_connects_to_every_address_of_a_machine(host, given):
    where = f"tcp/{host}:7447"
    agents = ["b"] if given == "router" else ["b", Agent("a", **{given: where})]
    with pytest.raises(mdm.ConfigError) as wrong:
        Team("t", agents, router=where if given == "router" else None)
    assert str(wrong.value) == (
        f"team.{'router' if given == 'router' else 'agents.1'}: nobody can connect to {where!r}, every address of a "
        "machine at once: an agent may `listen` there, and the others `connect` to its host by name or address, such "
        "as 'tcp/robot1.local:7447'"
    )


def test_an_agent_listens_where_it_is_and_is_reached_where_the_others_see_it():
    """Two containers listen at one port, which is another of their host for each."""
    agents = [Agent(name, listen="tcp/0.0.0.0:7447", connect=f"tcp/host:{port}") for name, port in (("a", 1), ("b", 2))]
    team = Team("t", [*agents, ("c", "tcp/10.0.0.3:7447"), Agent("d", listen="tcp/h:3"), Agent("e", connect="tcp/h:4")])
    reached = ["tcp/host:1", "tcp/host:2", "tcp/10.0.0.3:7447", "tcp/h:3", "tcp/h:4"]
    listens = ["tcp/0.0.0.0:7447", "tcp/0.0.0.0:7447", *reached[2:]]
    assert list(team.endpoints().values()) == reached
    for place, (name, end) in enumerate(zip(team.names, listens, strict=True)):
        assert team.addresses(name) == {"listen": [end], "connect": reached[:place]}
    assert team.addresses() == {"listen": [], "connect": reached}


@pytest.mark.parametrize("agent", ["a", "b", None])
def test_with_a_router_everybody_connects_to_it_alone(agent):
    team = Team("t", ["a", "b"], router="tcp/r:7447")
    assert team.endpoints() == {"a": "tcp/r:7447", "b": "tcp/r:7447"}
    assert team.addresses(agent) == {"listen": [], "connect": ["tcp/r:7447"], "mode": "client"}


def test_an_unknown_agent_is_told_with_similar_names():
    with refused(mdm.ConfigError):
        Team("t", ["robot1", "robot2"]).check_agent("robot3")


def test_a_team_is_public_and_imports_no_zenoh():
    code = "import mdm, sys; mdm.Team('t', ['a', 'b']); assert 'zenoh' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("mode", ["centralised", "communicating"])
def test_a_quorum_is_for_teams_that_agree(mode):
    with refused(mdm.ConfigError):
        Team("t", ["a", "b"], mode=mode, quorum="majority")
