"""One file for a team: what each agent takes of it."""

from __future__ import annotations

import asyncio
import sys

import pytest
from sentences import refused
from team_file import running, write

import mdm
from mdm import ConfigError, load_system
from mdm.config import load_team


def problems(path, agent="a"):
    with pytest.raises(ConfigError) as caught:
        load_system(path, agent=agent)
    return {problem.key: problem.message for problem in caught.value.problems}


def test_agents_of_one_file_decide_together(tmp_path):
    path = write(tmp_path)

    async def main():
        async with running(path) as (systems, _):
            await asyncio.sleep(1.0)
            systems["a"].predicates.sense("InLab", False)
            systems["b"].predicates.sense("InLab", True)
            await asyncio.sleep(1.0)
            return sys.modules["team_code"].done

    assert mdm.run(main, virtual=True) == ["a", "b", "stay", "go"]


def test_the_team_is_the_file_s(tmp_path):
    path = write(
        tmp_path, ('["a", "b"]', '["a", { name = "b", endpoint = "tcp/10.0.0.2:7447" }]\nperiod = 0.5\nlease = 2')
    )
    team = load_team(path)
    assert [(agent.name, agent.endpoint) for agent in team.agents] == [
        ("a", "tcp/127.0.0.1:7600"),
        ("b", "tcp/10.0.0.2:7447"),
    ]
    assert (team.name, team.period, team.mode) == ("rooms", 0.5, "replicated")
    system = load_system(path, agent="b")
    assert system.agent == "b"
    assert system.member.agent == "b"
    assert system.ensembles["joint"].agent == 1


def test_a_file_without_a_team_has_no_agents(tmp_path):
    path = write(tmp_path, ('[team]\nname = "rooms"\nagents = ["a", "b"]\nport = 7600\n', ""))
    assert load_team(path) is None
    assert "no table [team]" in problems(path)["team"]


def test_each_agent_may_have_actions_and_tasks_of_its_own(tmp_path):
    path = write(
        tmp_path,
        ('tasks = ["team_code:sense"]\n', ""),
        ('[ensembles.joint.actions]\nstay = "team_code:stay"\ngo = "team_code:go"', '[tasks]\nb = ["team_code:sense"]'),
    )
    with path.open("a") as file:
        file.write('[ensembles.joint.actions.a]\nstay = "team_code:stay"\ngo = { ensemble = "below" }\n')
        file.write('[ensembles.joint.actions.b]\nstay = "team_code:go"\ngo = "nowhere:go"\n')
        file.write('[ensembles.below]\npolicy = [0]\nactions = { X = "team_code:go" }\n')
    a = load_system(path, agent="a")
    assert (len(a.tasks), set(a.ensembles)) == (0, {"joint", "below"})
    assert a.top == (a.ensembles["joint"],)
    assert problems(path, "b") == {
        "ensembles.joint.actions.go": "there is no module 'nowhere'; the file's folder is searched first"
    }
    path.write_text(path.read_text().replace("nowhere", "team_code"))
    b = load_system(path, agent="b")
    assert (len(b.tasks), set(b.ensembles)) == (1, {"joint"})


def test_an_agent_may_have_ensembles_of_its_own_beside_the_team(tmp_path):
    path = write(tmp_path)
    with path.open("a") as file:
        file.write('[ensembles.lamp]\nagents = ["b"]\npolicy = [0, 1]\nstates = { s = ["b/InLab"] }\n')
        file.write('actions = { Off = "team_code:stay", On = "team_code:go" }\n')
    assert set(load_system(path, agent="a").ensembles) == {"joint"}
    b = load_system(path, agent="b")
    assert set(b.ensembles) == {"joint", "lamp"}
    assert b.ensembles["lamp"].state.factors[0].predicates == ("InLab",)
    assert set(b.member.ensembles) == {"joint"}


def test_names_of_other_agents_are_those_of_the_file(tmp_path):
    predicates = 'Together = "a/InLab and b/InLab"\nHeard = { set = "b/Hello", reset = "Bye" }'
    path = write(tmp_path, ("InLab = {}", f"InLab = {{}}\n{predicates}\n[events]\nHello = {{}}\nBye = {{}}"))

    async def main():
        async with running(path) as (systems, _):
            a, b = systems["a"].predicates, systems["b"].predicates
            await asyncio.sleep(1.0)
            a.sense("InLab", True)
            assert (a.value("Together"), b.value("Together")) == (None, None)
            b.sense("InLab", True)
            await asyncio.sleep(1.0)
            assert (a.value("Together"), b.value("Together")) == (True, True)
            assert a.declared.definition("Together") == "InLab and b/InLab"
            b.occur("Hello")
            await asyncio.sleep(1.0)
            assert (a.value("Heard"), b.value("Heard")) == (True, True)

    mdm.run(main, virtual=True)


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ('name = "rooms"', "", "team", "'name' is missing"),
        ('name = "rooms"', 'name = "a/b"', "team.name", "a/b"),
        ('["a", "b"]', '["a", "a"]', "team.agents.1", "two agents are called 'a'"),
        ('["a", "b"]', "[]", "team.agents", "at least one"),
        ('["a", "b"]', '["a", { name = "b", end = 1 }]', "team.agents.1.end", "end"),
        ("port = 7600", "port = 65535", "team.port", "agent 'b' would listen at port 65536"),
        ("port = 7600", "prt = 7600", "team.prt", "did you mean 'port'"),
        ("port = 7600", 'mode = "replicate"', "team.mode", "is not one of 'replicated'"),
        ("port = 7600", "period = 1\ndrive = 1", "team.drive", "not both"),
        ("port = 7600", 'controller = "a"', "team.controller", "centralised"),
        ('owner = "a"', 'owner = "c"', "ensembles.joint.states.room_a.owner", "has no agent 'c'"),
        (', owner = "a"', "", "ensembles.joint.states.room_a", "give it an owner"),
        ('"rooms.npz"', '"rooms.npz"\nagents = ["a"]', "ensembles.joint.agents", "all agents of team 'rooms' decide"),
        ('"rooms.npz"', '"rooms.npz"\nagents = ["c"]', "ensembles.joint.agents", "no agent 'c'"),
        ('"rooms.npz"', '"rooms.npz"\nagent = 1', "ensembles.joint.agent", "each agent acts for itself"),
        ('"rooms.npz"', '"rooms.npz"\ndrive = 1', "ensembles.joint.drive", "leave it out"),
        ('"rooms.npz"', '"rooms.npz"\nplacement = { controll = "a" }', "ensembles.joint.placement.controll", "control"),
        ('"rooms.npz"', '"rooms.npz"\nplacement = { control = "c" }', "ensembles.joint.placement.control", "'c'"),
        (
            '"rooms.npz"',
            '"rooms.npz"\nsafe_action = { a = "team_code:stay", b = "team_code:go" }',
            "ensembles.joint.safe_action",
            "is not given by agent: give the name of an action",
        ),
        ("InLab = {}", 'InLab = {}\nT = "c/InLab"', "predicates.T", "has no agent 'c'"),
        ("InLab = {}", 'InLab = {}\nT = "b/InLap"', "predicates.T", "did you mean 'InLab'"),
        ('"InLab" }, owner = "b"', '"b/InLap" }, owner = "b"', "ensembles.joint.states.room_b", "'b/InLap'"),
        ('tasks = ["team_code:sense"]', 'tasks = { c = ["team_code:sense"] }', "tasks", "has no agent 'c'"),
    ],
)
def test_what_is_wrong_in_a_team_s_file_is_told_with_its_key(tmp_path, old, new, key, words):
    found = problems(write(tmp_path, (old, new)))
    assert key in found
    assert words in found[key]


def test_an_agent_is_to_be_named(tmp_path):
    path = write(tmp_path)
    with refused(ConfigError):
        load_system(path)
    with refused(ConfigError):
        load_system(path, agent="c")


def test_keys_of_teams_need_a_team(tmp_path):
    start = '[team]\nname = "rooms"\nagents = ["a", "b"]\nport = 7600\n'
    path = write(tmp_path, (start, ""), ('"rooms.npz"', '"rooms.npz"\nagents = ["a"]'))
    with refused(ConfigError):
        load_system(path)
    path = write(tmp_path, (start, ""))
    with refused(ConfigError):
        load_system(path)


def test_a_robot_is_controlled_from_off_board(tmp_path):
    path = write(
        tmp_path,
        ('["a", "b"]', '["robot", "base"]'),
        (', owner = "a"', ""),
        (', owner = "b"', ""),
        ("[ensembles.joint.states]\n", ""),
    )
    text = path.read_text().split("[ensembles.joint]")[0]
    text += """
[ensembles.lamp]
model = "lamp.npz"
policy = [0, 1]
placement = { control = "base", actions = "robot", inputs = "robot" }
states = { room = ["InLab"] }
actions.robot = { stay = "team_code:stay", go = "team_code:go" }
"""
    path.write_text(text)
    import numpy as np

    from mdm.models import MDP, Factor, Space

    names = Space([Factor("room", ["hall", "lab"])])
    mdm.save_model(
        MDP([np.eye(2)] * 2, np.zeros((2, 2)), discount=0.9, states=names, actions=["stay", "go"]),
        tmp_path / "lamp.npz",
    )

    async def main():
        async with running(path) as (systems, _):
            await asyncio.sleep(1.0)
            systems["robot"].predicates.sense("InLab", False)
            await asyncio.sleep(1.0)
            systems["robot"].predicates.sense("InLab", True)
            await asyncio.sleep(1.0)
            assert systems["base"].ensembles["lamp"].controller.epoch >= 1
            return sys.modules["team_code"].done

    assert mdm.run(main, virtual=True) == ["robot", "base", "stay", "go"]


def test_a_factor_that_the_model_has_not_is_not_asked_for_its_owner(tmp_path):
    path = write(tmp_path, ("room_b = ", "room_c = "), (', owner = "b"', ""))
    with pytest.raises(ConfigError) as caught:
        load_system(path, agent="a")
    assert [(problem.key, problem.message) for problem in caught.value.problems] == [
        ("ensembles.joint.states.room_c", "the model has no state factor 'room_c'; did you mean 'room_b' or 'room_a'?")
    ]


@pytest.mark.parametrize(("old", "new", "count"), [("", "", 0), ('owner = "b"', 'owner = "bb"', 1)])
def test_agents_may_have_events_of_the_same_names(tmp_path, old, new, count):
    mdm.save_model(mdm.problems.dec_tiger(discount=0.9), tmp_path / "tiger.dpomdp")
    text = """
[team]
name = "tigers"
agents = ["a", "b"]
period = 0.5

[events]
L = {}
R = {}

[ensembles.doors]
model = "tiger.dpomdp"
policy = "tiger.vf"

[ensembles.doors.observations]
agent0 = { events = { hear-left = "L", hear-right = "R" }, owner = "a" }
agent1 = { events = { hear-left = "L", hear-right = "R" }, owner = "b" }

[ensembles.doors.actions]
listen = "team_code:stay"
open-left = "team_code:go"
open-right = "team_code:go"
"""
    (tmp_path / "tiger.vf").write_text("0 -1\n1 1\n\n")
    path = write(tmp_path, (old, new), text=text)
    if not count:
        assert load_system(path, agent="a").agent == "a"
        return
    assert list(problems(path)) == ["ensembles.doors.observations.agent1.owner"]
