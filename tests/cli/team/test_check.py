"""`mdm team check`: what `run` would refuse, at every agent."""

from __future__ import annotations

import sys

import pytest


@pytest.mark.parametrize("verb", [("team", "check"), ("check",)])
def test_a_file_without_problems(mdm, free, verb):
    team = free()
    assert mdm(*verb, team) == (0, [f"{team}: team 'rooms' of 2 agents (a, b), no problems found"], "")


def test_problems_are_told_with_the_agents_that_have_them(mdm, free):
    team = free(('stay = "team_code:stay"\n', ""), ('go = "team_code:go"\n', ""), ("[ensembles.joint.actions]\n", ""))
    with team.open("a") as file:
        file.write('[ensembles.joint.actions.a]\nstay = "team_code:stay"\ngo = "team_code:goo"\n')
        file.write('[ensembles.joint.actions.b]\nstay = "team_code:stay"\n')
    status, _, errors = mdm("team", "check", team)
    assert status == 1
    first, second, last = errors.splitlines()
    assert first.endswith("module 'team_code' has no 'goo'; did you mean 'go'? (at a)")
    assert "ensembles.joint.a" in second
    assert second.endswith("(at b)")
    assert last == f"mdm team check: {team}: 2 problems found"


@pytest.mark.parametrize("verb", [("team", "check"), ("check",), ("info",)])
def test_no_module_is_run_without_being_asked(mdm, free, verb):
    team = free()
    code = team.parent / "team_code.py"
    code.write_text(code.read_text() + "\nraise SystemExit('this was run')\n")
    status, _, errors = mdm(*verb, team)
    assert (status, errors) == (0, "")
    status, _, errors = mdm(*verb, "--import", team)
    assert status == 1
    assert "this was run" in errors


def test_problems_of_the_team_itself(mdm, free):
    team = free(('name = "rooms"', 'name = "ro/oms"'))
    status, _, errors = mdm("team", "check", team)
    assert status == 1
    assert "team.name: " in errors


def test_without_zenoh_there_is_a_sentence(mdm, free, monkeypatch):
    monkeypatch.setitem(sys.modules, "zenoh", None)
    status, _, errors = mdm("team", "check", free())
    assert status == 1
    assert "Zenoh, which is not installed: pip install eclipse-zenoh" in errors


def test_one_that_others_cannot_reach_is_noted(mdm, free):
    team = free()
    here = team.read_text().partition('endpoint = "')[2].partition('"')[0]
    team.write_text(team.read_text().replace(here, "tcp/192.168.0.7:7447"))
    status, output, _ = mdm("team", "check", team)
    assert status == 0
    assert any("b can be reached from its own machine alone" in line for line in output)
    assert any("whoever reaches tcp/192.168.0.7:7447 can speak as any agent of the team" in line for line in output)


@pytest.mark.parametrize(
    "verb",
    [
        ("team", "check"),
        ("check",),
        ("team", "up", "--seconds", "1"),
        ("team", "run", "--agent", "b", "--seconds", "1"),
    ],
)
@pytest.mark.parametrize("host", ["0.0.0.0", "[::]"])
def test_nobody_connects_to_every_address_of_a_machine(mdm, free, verb, host):
    team = free()
    here = team.read_text().partition('endpoint = "')[2].partition('"')[0]
    team.write_text(team.read_text().replace(here, f"tcp/{host}:7447"))
    status, _, errors = mdm(*verb, team)
    assert status != 0
    assert f"team.agents.0: nobody can connect to 'tcp/{host}:7447'" in errors
    assert "an agent may `listen` there, and the others `connect` to its host by name" in errors
    team.write_text(team.read_text().replace("endpoint =", 'connect = "tcp/host.local:7447", listen =', 1))
    assert mdm("team", "check", team)[0] == 0


def beside(mdm, team, *changes):
    """Write a second file of the team with changes; return what the check of the first one notes."""
    text = team.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (team.parent / "other.toml").write_text(text)
    status, output, errors = mdm("check", team)
    assert (status, errors) == (0, "")
    found = [line.removeprefix(f"{team}: note: agents of this file and of other.toml ") for line in output[:-1]]
    return [line for line in found if line not in output]


def at(team, name):
    return team.read_text().partition(f'name = "{name}", endpoint = "')[2].partition('"')[0]


def test_another_file_of_the_team_is_compared(mdm, free):
    team = free()
    a, b = at(team, "a"), at(team, "b")
    never = "never meet: their team is 'rooms' here, and {!r} there"
    assert beside(mdm, team) == []
    assert beside(mdm, team, ('"rooms"', '"roms"')) == [never.format("roms")]
    assert beside(mdm, team, ('"rooms"', '"quite-another"')) == [never.format("quite-another")]
    order = (a, "x"), ('"a", endpoint', '"c", endpoint'), ('"b", endpoint', '"a", endpoint'), ('"c", e', '"b", e')
    assert beside(mdm, team, *order, (b, a), ("x", b)) == ["never decide together: a, b here, and b, a there"]
    assert beside(mdm, team, (b, "tcp/127.0.0.1:7777")) == [
        f"look for 'b' at different addresses: {b} here, and tcp/127.0.0.1:7777 there"
    ]
    assert beside(mdm, team, (a, "tcp/127.0.0.1:7777"), (b, a)) == [
        f"look for 'a' at different addresses: {a} here, and tcp/127.0.0.1:7777 there",
        f"look for different agents at {a}: 'a' here, and 'b' there",
        f"look for 'b' at different addresses: {b} here, and {a} there",
    ]
    assert beside(mdm, team, (a, a.replace("127.0.0.1", "localhost"))) == []


def test_files_of_other_teams_and_those_that_are_none_are_not(mdm, free):
    team = free()
    (team.parent / "none.toml").write_text("")
    (team.parent / "wrong.toml").write_text("[team]\nname = 7\n")
    (team.parent / "folder.toml").mkdir()
    elsewhere = (at(team, "a"), "tcp/127.0.0.1:7777"), (at(team, "b"), "tcp/127.0.0.1:7778")
    assert beside(mdm, team, ('name = "rooms"', 'name = "quite-another"'), *elsewhere) == []
    plain = [(f'{{ name = "{name}", endpoint = "{at(team, name)}" }}', f'"{name}"') for name in "ab"]
    team.write_text(team.read_text().replace(plain[0][0], '"a"').replace(plain[1][0], '"b"'))
    assert beside(mdm, team, ('name = "rooms"', 'name = "quite-another"')) == []  # both at the usual ports
    assert beside(mdm, team, ('name = "rooms"', 'name = "quite-another"\nport = 7777')) == []


@pytest.mark.parametrize(("days", "notes"), [(5, ["'a'", "'b'", "'operator'"]), (30, [])])
def test_how_long_certificates_are_valid_is_told(mdm, free, tmp_path, days, notes):
    pytest.importorskip("cryptography", reason="the extra mdm[certificates]")
    team = free(('name = "rooms"', 'name = "rooms"\naccess = "keys"'))
    team.write_text(team.read_text().replace("tcp/", "tls/"))
    assert mdm("team", "certificates", team, "-o", tmp_path / "keys", "--days", days)[0] == 0
    status, output, _ = mdm("team", "check", team)
    assert status == 0
    assert (
        output[-1] == f"{team}: team 'rooms' of 2 agents (a, b), with certificates for {days}.0 days, no problems found"
    )
    told = ", or of the authority that signed it, ends in 5.0 days"
    assert output[:-1] == [f"{team}: note: the certificate of {name}{told}" for name in notes]


@pytest.mark.parametrize("verb", ["check", "status"])
def test_a_model_is_loaded_once_for_all_agents(mdm, free, verb, monkeypatch):
    from mdm.config import ensembles

    team, loaded = free(), []
    load = ensembles.load_model
    monkeypatch.setattr(ensembles, "load_model", lambda path: loaded.append(path) or load(path))
    mdm("team", verb, team)
    assert [path.name for path in loaded] == ["rooms.npz"]


@pytest.mark.parametrize("verb", [("team", "check"), ("check",)])
def test_all_problems_of_all_agents_are_told_at_once(mdm, free, verb):
    team = free(
        ('name = "rooms"', 'name = "rooms"\nperod = 1\nlease = -1'),
        ('tasks = ["team_code:sense"]', 'tasks = { c = ["team_code:sense"] }'),
        ('{ lab = "InLab" }, owner = "a"', '{ lab = "InLap" }, owner = "aa"'),
        ('owner = "b"', 'owner = "bb"'),
        ("[ensembles.joint.actions]\n", "[ensembles.joint.actions.a]\n"),
        ('go = "team_code:go"\n', ""),
    )
    with team.open("a") as file:
        file.write('[ensembles.joint.actions.b]\nstay = "team_code:sty"\ngo = "team_code:go"\n')
    status, _, errors = mdm(*verb, team)
    assert status == 1
    *told, last = errors.splitlines()
    places = [
        "team.perod: ",
        "team.lease: ",
        "tasks: ",
        "ensembles.joint.states.room_a.owner: ",
        "ensembles.joint.states.room_b.owner: ",
        "ensembles.joint.states.room_a: state factor 'room_a' uses 'InLap'",
        "ensembles.joint.actions.stay: module 'team_code' has no 'sty'",
        "nothing is bound to the action 'go'",
    ]
    found = [[line for line in told if place in line] for place in places]
    assert [len(lines) for lines in found] == [1] * len(places)
    assert last.endswith(f"{len(places)} problems found")
    assert found[-1][0].endswith("(at a)")
    assert found[-2][0].endswith("(at b)")
