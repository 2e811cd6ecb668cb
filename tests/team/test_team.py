"""What a team is told, and refuses."""

from __future__ import annotations

import subprocess
import sys

import pytest
from sentences import refused

import mdm
from mdm.team.team import Agent, Team
from mdm.team.transport.ceilings import Ceiling


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
        ({"agents": [("a", "tcp/h:1"), ("b", "tcp/h:1")]}, "two agents listen at 'tcp/h:1'"),
        ({"agents": [("a", "nowhere")]}, "an endpoint is a protocol, a host and a port"),
        ({"mode": "anarchy"}, "mode is 'replicated' or"),
        ({"quorum": "all"}, "quorum is 'majority' or 'continue'"),
        ({"period": 0}, "period is a number of seconds"),
        ({"period": 1.0, "drive": "event"}, "a period or a drive, not both"),
        ({"drive": "sometimes"}, "a drive is"),
        ({"period": 1.0, "deadline": 2.0}, "the next begins after 1 s"),
        ({"lease": -1}, "lease is a number of seconds"),
        ({"max_age": "long"}, "max_age is a number of seconds"),
        ({"ceilings": [Ceiling("mdm/**", rate=-1.0)]}, "ceilings"),
        ({"controller": "a"}, "a controller is for centralised teams"),
        ({"controller": "c", "mode": "centralised"}, "has no agent 'c'"),
        ({"mode": "centralised", "deadline": 0.2}, "decides on each as it comes, and waits for nothing"),
    ],
)
def test_what_means_nothing_is_refused(given, words):
    options = {"name": "team", "agents": ["a", "b"]} | given
    with pytest.raises(mdm.ConfigError, match=words):
        Team(options.pop("name"), options.pop("agents"), **options)


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
