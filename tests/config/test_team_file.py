"""What a file's table `team` says: endpoints, certificates, limits."""

from __future__ import annotations

from pathlib import Path

import pytest
from sentences import refused
from team_file import write

from mdm import ConfigError
from mdm.config import load_system, load_team, load_team_file
from mdm.config.functions import Functions
from mdm.config.problems import Problems
from mdm.config.team_file import read_team


def test_endpoints_derive_from_a_port(tmp_path):
    assert [agent.endpoint for agent in load_team(write(tmp_path)).agents] == [
        "tcp/127.0.0.1:7600",
        "tcp/127.0.0.1:7601",
    ]


def test_certificates_are_in_a_folder_beside_the_file(tmp_path):
    described = load_team_file(write(tmp_path, ("port = 7600", 'port = 7600\naccess = "keys"')))
    assert [agent.endpoint for agent in described.team.agents] == ["tls/127.0.0.1:7600", "tls/127.0.0.1:7601"]
    access = described.access("b")
    assert (access.authority, access.certificate, access.key) == tuple(
        str(tmp_path / "keys" / name) for name in ("authority.pem", "b.pem", "b.key.pem")
    )
    with refused(ConfigError):
        load_system(tmp_path / "team.toml", agent="b")


def test_limits_are_those_of_the_file(tmp_path):
    limits = (
        'port = 7600\nallowance = { messages = 50, bytes = 20_000 }\nceilings = [{ keys = "mdm/rooms/*/x", rate = 10 }]'
    )
    described = load_team_file(write(tmp_path, ("port = 7600", limits)))
    assert described.team.ceilings[0].rate == 10
    allowance = described.options("a")["allowance"]
    assert (allowance.messages, allowance.bytes) == (50, 20_000)
    assert allowance is not described.options("b")["allowance"]


def test_the_memory_of_a_team_is_that_of_its_ensembles(tmp_path):
    path = write(tmp_path)
    assert load_team_file(path).team.memory == 1000
    assert load_system(path, agent="a").ensembles["joint"].controller.model.is_sparing
    path = write(tmp_path, ("port = 7600", "port = 7600\nmemory = 0.0001"))
    assert load_team_file(path).team.memory == 0.0001
    with refused(ConfigError):
        load_system(path, agent="a")
    with_own = ('model = "rooms.npz"', 'model = "rooms.npz"\nmemory = 200')
    load_system(write(tmp_path, ("port = 7600", "port = 7600\nmemory = 0.0001"), with_own), agent="a")


@pytest.mark.parametrize(
    ("given", "key", "words"),
    [
        ({"memory": 0}, "team.memory", "`float` > 0"),
        ({"allowance": {"message": 1}}, "team.allowance.message", "did you mean 'messages'"),
        ({"ceilings": [{"keys": "mdm/*/x"}]}, "team", "a rate, a size or a priority"),
        ({"ceilings": [{"rate": 1}]}, "team.ceilings.0", "'keys' is missing"),
        ({"access": 7}, "team.access", "Expected"),
    ],
)
def test_wrong_limits_are_told(given, key, words):
    problems = Problems(Path("team.toml"))
    described = read_team(
        {"name": "t", "agents": ["a"], **given}, Path(), Functions(Path(), problems, callbacks=False), problems
    )
    assert described.team.names == ("a",)  # so that the rest of the file can be checked
    with pytest.raises(ConfigError) as caught:
        problems.raise_all()
    assert key in {problem.key for problem in caught.value.problems}
    assert words in str(caught.value)
