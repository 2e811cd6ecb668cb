"""What a file's table `team` says: endpoints, certificates, limits."""

from __future__ import annotations

from pathlib import Path

import pytest
from sentences import refused
from team_file import write

from mdm import ConfigError
from mdm.config import load_system, load_team, load_team_file
from mdm.config.functions import Functions
from mdm.config.tables import Problems
from mdm.config.team_file import read_team
from mdm.runtime import VirtualClock
from mdm.team.transport.network import Network
from mdm.team.transport.settings import Ceiling


@pytest.mark.parametrize("port", [7600, 9100])
def test_endpoints_derive_from_a_port(tmp_path, port):
    assert [agent.endpoint for agent in load_team(write(tmp_path, ("port = 7600", f"port = {port}"))).agents] == [
        f"tcp/127.0.0.1:{port}",
        f"tcp/127.0.0.1:{port + 1}",
    ]


@pytest.mark.parametrize(
    "given",
    [
        {"period": 0.5, "deadline": 0.125, "lease": 2.0, "max_age": 3.0},
        {"drive": 4.0, "deadline": 0.25, "lease": 0.5, "max_age": 0.75},
        {"drive": 10.0, "lease": 5.0},
        {"period": 0.2, "max_age": 1.5},
    ],
)
def test_seconds_of_a_team_are_those_of_the_file(tmp_path, given):
    lines = "".join(f"\n{key} = {value}" for key, value in given.items())
    team = load_team(write(tmp_path, ("port = 7600", f"port = 7600{lines}")))
    assert team.period == (given["period"] if "period" in given else 1 / given["drive"])
    assert team.deadline == given.get("deadline", team.period / 2)
    assert (team.lease, team.max_age) == (given.get("lease", 1.0), given.get("max_age", 1.0))


def test_addresses_of_the_file_are_those_of_the_team(tmp_path):
    here = '{ name = "a", listen = "tcp/0.0.0.0:7447", connect = "tcp/host.local:17447" }'
    team = load_team(write(tmp_path, ('agents = ["a", "b"]', f'agents = [{here}, "b"]')))
    assert team.addresses("a") == {"listen": ["tcp/0.0.0.0:7447"], "connect": []}
    assert team.addresses("b") == {"listen": ["tcp/127.0.0.1:7601"], "connect": ["tcp/host.local:17447"]}
    team = load_team(write(tmp_path, ('agents = ["a", "b"]', 'agents = ["a", "b"]\nrouter = "tcp/r.local:7447"')))
    assert team.addresses("a") == {"listen": [], "connect": ["tcp/r.local:7447"], "mode": "client"}


def test_certificates_are_in_a_folder_beside_the_file(tmp_path):
    described = load_team_file(write(tmp_path, ("port = 7600", 'port = 7600\naccess = "keys"')))
    assert [agent.endpoint for agent in described.team.agents] == ["tls/127.0.0.1:7600", "tls/127.0.0.1:7601"]
    access = described.access("b")
    assert (access.authority, access.certificate, access.key) == tuple(
        str(tmp_path / "keys" / name) for name in ("authority.pem", "b.pem", "b.key.pem")
    )
    with refused(ConfigError):
        load_system(tmp_path / "team.toml", agent="b")


@pytest.mark.parametrize(("messages", "size", "burst"), [(50, 20_000, 1.0), (4, 1_500, 2.5)])
def test_an_agent_sends_what_the_file_allows(tmp_path, messages, size, burst):
    """What was saved in the silence before is sent at once; the rest as time passes."""

    def allowed(limits):
        described = load_team_file(write(tmp_path, ("port = 7600", f"port = 7600\nallowance = {{ {limits} }}")))
        allowance = described.options("a")["allowance"]
        assert allowance is not described.options("b")["allowance"]
        return allowance

    by_count = allowed(f"messages = {messages}, burst = {burst}")
    assert sum(by_count.spend(10, "value", 0.0) for _ in range(200)) == messages * burst
    assert sum(by_count.spend(10, "value", 0.5) for _ in range(200)) == messages / 2
    by_size = allowed(f"bytes = {size}, burst = {burst}")
    assert sum(by_size.spend(size // 10, "value", 0.0) for _ in range(200)) == 10 * burst


@pytest.mark.parametrize(("rate", "size"), [(10, 4096), (0.5, 300)])
def test_ceilings_are_those_of_the_file(tmp_path, rate, size):
    ceiling = f'{{ keys = "mdm/rooms/*/x", rate = {rate}, size = {size} }}'
    team = load_team(write(tmp_path, ("port = 7600", f"port = 7600\nceilings = [{ceiling}]")))
    assert team.ceilings == (Ceiling("mdm/rooms/*/x", rate=rate, size=size),)


def test_the_memory_of_a_team_is_that_of_its_ensembles(tmp_path):
    path = write(tmp_path)
    assert load_team_file(path).team.memory == 1000
    assert load_system(path, agent="a").ensembles["joint"].controller.model.is_sparing
    assert load_team_file(write(tmp_path, ("port = 7600", "port = 7600\nmemory = 20"))).team.memory == 20
    path = write(tmp_path, ("port = 7600", "port = 7600\nmemory = 0.0001"))
    assert load_team_file(path).team.memory == 0.0001
    with refused(ConfigError):
        load_system(path, agent="a")
    with_own = ('model = "rooms.npz"', 'model = "rooms.npz"\nmemory = 200')
    load_system(write(tmp_path, ("port = 7600", "port = 7600\nmemory = 0.0001"), with_own), agent="a")


@pytest.mark.parametrize(
    ("given", "key", "words"),
    [
        ({"memory": 0}, "team.memory", "a number of megabytes above 0 was expected, not 0"),
        ({"allowance": {"message": 1}}, "team.allowance.message", "did you mean 'messages'"),
        ({"ceilings": [{"keys": "mdm/*/x"}]}, "team", "a rate, a size or a priority"),
        ({"ceilings": [{"rate": 1}]}, "team.ceilings.0", "'keys' is missing"),
        ({"access": 7}, "team.access", "was expected, not 7"),
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


@pytest.mark.parametrize(
    ("given", "folder"), [("", "."), ('\nstate = "kept"', "kept"), ('\nstate = "/var/x"', "/var/x")]
)
def test_agents_keep_their_stops_beside_the_file_unless_it_names_a_folder(tmp_path, given, folder):
    described = load_team_file(write(tmp_path, ("port = 7600", f"port = 7600{given}")))
    assert described.options("a")["state"] == tmp_path / folder
    assert described.team.state is None  # on a simulated network nothing is kept


def test_on_a_simulated_network_nothing_is_kept(tmp_path):
    path = write(tmp_path)
    network = Network(VirtualClock(), team="rooms")
    simulated = load_system(path, agent="a", transport=network.transport("a"))
    assert simulated.member.layers["joint"].storage is None
    pytest.importorskip("zenoh", reason="pip install eclipse-zenoh")
    real = load_system(path, agent="a")
    assert real.member.layers["joint"].storage.file == tmp_path / "a@rooms.state"


@pytest.mark.parametrize("name", ["calls", "link", "clocks", "exports"])
def test_an_ensemble_that_is_called_as_an_actor_of_its_team_is_refused_by_its_key(tmp_path, name):
    with pytest.raises(ConfigError) as caught:
        load_system(write(tmp_path, ("ensembles.joint", f"ensembles.{name}")), agent="a", callbacks=False)
    (problem,) = caught.value.problems
    assert problem.key == f"ensembles.{name}"
    assert problem.message.startswith(f"an ensemble cannot be called {name!r}, as an actor beside it is")
