from __future__ import annotations

import asyncio
import json
import time

import pytest
from patience import PATIENCE
from sentences import refused
from transports import LOOPBACK, Loopback, endpoint, free_port, key, routing, two_days_ago

from mdm.errors import ConfigError
from mdm.team.transport import access, certificates
from mdm.team.transport.access import Access, access_settings, valid_until
from mdm.team.transport.certificates import make_certificates
from mdm.team.transport.router import Packer
from mdm.team.transport.session import Session

AGENTS = ["a", "b", "c"]


@pytest.fixture
def files(tmp_path):
    pytest.importorskip("zenoh")
    pytest.importorskip("cryptography")
    return make_certificates(tmp_path / "team", {agent: ["127.0.0.1"] for agent in AGENTS})


@pytest.fixture
def guarded(files):
    """Run a test on sessions that show certificates."""
    return lambda main: LOOPBACK(main, files=files, agents=AGENTS)


def test_agents_with_certificates_talk_ask_and_see_each_other(guarded):
    async def main(net):
        sessions = [net.transport(agent) for agent in AGENTS]
        got, seen = {agent: [] for agent in AGENTS}, {agent: [{}] for agent in AGENTS}
        for session in sessions:
            name = session.agent
            session.subscribe("mdm/team/**", lambda sample, name=name: got[name].append(sample.body))
            session.subscribe("mdm/team/*/@team/step", lambda sample, name=name: got[name].append(sample.body))
            session.serve(key(name, "call"), lambda body, name=name: name.encode())
            session.watch(seen[name].append)
            await session.open()
        await net.until(lambda: all(set(lives[-1]) == set(AGENTS) for lives in seen.values()))
        sessions[0].put(key("a"), b"value")
        sessions[0].put("mdm/team/a/@team/step", b"step", priority="step")
        await net.until(lambda: sorted(got["b"]) == sorted(got["c"]) == [b"step", b"value"])
        assert await sessions[2].ask("mdm/team/*/e/call", timeout=PATIENCE) == {"a": b"a", "b": b"b"}

    guarded(main)


def test_a_forged_key_is_refused_by_zenoh(guarded):
    async def main(net):
        a, b = net.transport("a"), net.transport("b")
        got, seen = [], [{}]
        a.subscribe("mdm/team/**", lambda sample: got.append((sample.owner, sample.body)))
        b.watch(seen.append)
        await a.open()
        await b.open()
        await net.until(lambda: "a" in seen[-1])
        forged = Packer("c", 1, int)
        b._zenoh.put(key("c"), forged.pack(key("c"), b"I am c"))
        b._zenoh.liveliness().declare_token("mdm/team/c/@team/live/7")
        b.put(key("b"), b"I am b")
        await net.until(lambda: got)
        assert got == [("b", b"I am b")]
        assert a.statistics().dropped == {}  # it did not come so far as to be dropped here
        assert "c" not in a._tokens

    guarded(main)


def test_a_certificate_of_another_authority_is_not_let_in(guarded, tmp_path, monkeypatch):
    async def main(net):
        others = make_certificates(tmp_path / "others", {"b": ["127.0.0.1"]})
        monkeypatch.setattr(access, "_check_certificate", lambda *_: None)  # it does not look at what it shows
        a, false, true = net.transport("a"), net.transport("b", shown=others["b"]), net.transport("c")
        seen = [{}]
        a.watch(seen.append)
        await a.open()
        await false.open()
        await true.open()
        await net.until(lambda: "c" in seen[-1])
        assert all("b" not in live for live in seen)

    guarded(main)


def test_without_a_certificate_nobody_is_let_in(guarded):
    async def main(net):
        a = net.transport("a")
        seen = [{}]
        a.watch(seen.append)
        await a.open()
        plain = Session(
            "team", "b", listen=f"tcp/127.0.0.1:{free_port()}", connect=[net.endpoints[0].replace("tls", "tcp")]
        )
        net.made.append(plain)
        await plain.open()
        c = net.transport("c")
        await c.open()
        await net.until(lambda: "c" in seen[-1])
        assert all("b" not in live for live in seen)

    guarded(main)


def test_with_certificates_an_endpoint_that_everybody_reaches_is_no_risk(guarded):
    async def main(net):
        reports = []
        session = net.transport("a", listen=f"tls/0.0.0.0:{free_port()}")
        session.supervise(pytest.fail, lambda kind, reason: reports.append((kind, reason)))
        await session.open()
        assert reports == []

    guarded(main)


@pytest.fixture
def routed(tmp_path):
    """Agents and an operator that have each a session through one router, all of which show certificates."""
    pytest.importorskip("zenoh")
    pytest.importorskip("cryptography")
    files = make_certificates(tmp_path, {agent: ["127.0.0.1"] for agent in (*AGENTS, "operator", "router")})
    where = endpoint(protocol="tls")

    class Routed(Loopback):
        def transport(self, agent, *, shown=None):
            configuration = access_settings(files[shown or agent], "team", shown or agent, AGENTS, routed=True)
            made = Session(
                "team", agent, listen=[], connect=[where], mode="client", lease=2.0, configuration=configuration
            )
            self.made.append(made)
            return made

    def run(main):
        async def within():
            net = Routed()
            try:
                await main(net)
            finally:
                await net.close()

        with routing(where, files["router"], AGENTS):
            asyncio.run(within())

    return run


def test_behind_a_router_agents_talk_ask_and_see_each_other_and_the_operator_asks(routed):
    async def main(net):
        sessions = [net.transport(agent) for agent in AGENTS]
        got = {agent: [] for agent in AGENTS}
        for session in sessions:
            session.subscribe("mdm/team/**", lambda sample, name=session.agent: got[name].append(sample.body))
            session.serve(key(session.agent, "call"), lambda body, name=session.agent: name.encode())
        await net.open(*sessions)
        sessions[0].put(key("a"), b"value")
        await net.until(lambda: got == {"a": [], "b": [b"value"], "c": [b"value"]})
        operator = net.transport("asker-1", shown="operator")
        await operator.open()
        assert await operator.ask("mdm/team/*/e/call", timeout=PATIENCE) == {"a": b"a", "b": b"b", "c": b"c"}

    routed(main)


def test_the_router_refuses_a_forged_key_though_agents_believe_it(routed):
    async def main(net):
        a, b = net.transport("a"), net.transport("b")
        got = []
        a.subscribe("mdm/team/**", lambda sample: got.append((sample.owner, sample.body)))
        await net.open(a, b)
        b._zenoh.put(key("c"), Packer("c", 1, int).pack(key("c"), b"I am c"))
        b._zenoh.liveliness().declare_token("mdm/team/c/@team/live/7")
        operator = net.transport("asker-1", shown="operator")
        await operator.open()
        operator._zenoh.put(key("c"), Packer("c", 1, int).pack(key("c"), b"I am c"))
        b.put(key("b"), b"I am b")
        await net.until(lambda: got)
        assert got == [("b", b"I am b")]
        assert (a.statistics().dropped, "c" in a._tokens) == ({}, False)

    routed(main)


def test_no_agent_has_the_name_of_the_router(files):
    with refused(ConfigError):
        access_settings(files["a"], "team", "a", ["a", "router"], routed=True)
    assert access_settings(files["a"], "team", "a", ["a", "router"])["access_control"]["enabled"]


def test_an_agent_that_comes_later_needs_no_new_certificates_of_the_others(tmp_path):
    pytest.importorskip("zenoh")
    pytest.importorskip("cryptography")
    make_certificates(tmp_path, {agent: ["127.0.0.1"] for agent in "ab"})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    files = make_certificates(tmp_path, {agent: ["127.0.0.1"] for agent in AGENTS})
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    assert {path.name for path in tmp_path.iterdir()} - before.keys() == {"c.pem", "c.key.pem"}

    async def main(net):
        a, c = net.transport("a"), net.transport("c")
        got = []
        a.subscribe("mdm/team/**", lambda sample: got.append((sample.owner, sample.body)))
        await net.open(a, c)
        c.put(key("c"), b"I am new")
        await net.until(lambda: got)
        assert got == [("c", b"I am new")]

    LOOPBACK(main, files=files, agents=AGENTS)


@pytest.mark.parametrize("days", [1, 30])
def test_a_certificate_is_valid_as_long_as_its_authority_is(tmp_path, days, monkeypatch):
    pytest.importorskip("cryptography")
    now = time.time()
    own = make_certificates(tmp_path / "one", {"a": []}, days=days)["a"]
    assert valid_until(own) - now == pytest.approx(days * 86400, abs=60)
    monkeypatch.setattr(certificates, "_AUTHORITY_DAYS", 1)
    make_certificates(tmp_path / "two", {"a": []}, days=days)
    late = make_certificates(tmp_path / "two", {"a": [], "b": []}, days=100)["b"]
    assert valid_until(late) - now == pytest.approx(days * 86400, abs=60)


def test_files_that_are_missing_are_named(tmp_path):
    there = tmp_path / "there.pem"
    there.write_text("")
    with refused(ConfigError):
        access_settings(Access(str(there), str(tmp_path / "no.pem"), str(there)), "team", "a", AGENTS)


def refusal(shown, agent="a"):
    with pytest.raises(ConfigError) as refused:
        access_settings(shown, "team", agent, AGENTS)
    return str(refused.value)


def test_no_agent_has_the_name_of_whoever_asks(files):
    with refused(ConfigError):
        access_settings(files["a"], "team", "a", ["a", "operator"])


def test_a_certificate_that_others_would_refuse_is_refused_at_once(files, tmp_path):
    others = make_certificates(tmp_path / "others", {"a": []})
    with two_days_ago():
        expired = make_certificates(tmp_path / "expired", {"a": []}, days=1)
    a, b = files["a"], files["b"]
    assert refusal(b).endswith("b.pem is of b, not of agent 'a'")
    assert "others will not take" in refusal(Access(a.authority, others["a"].certificate, others["a"].key))
    assert "certificate has expired" in refusal(expired["a"])
    assert "is not the key to it" in refusal(Access(a.authority, a.certificate, b.key))
    garbage = tmp_path / "garbage.pem"
    garbage.write_text("garbage")
    assert "garbage.pem is no certificate" in refusal(Access(a.authority, str(garbage), a.key))
    assert "garbage.pem is no certificate" in refusal(Access(str(garbage), a.certificate, a.key))


def test_zenoh_takes_the_settings(files):
    zenoh = pytest.importorskip("zenoh")
    made = access_settings(files["a"], "team", "a", AGENTS)
    zenoh.Config.from_json5(json.dumps(made))
    assert [subject["cert_common_names"] for subject in made["access_control"]["subjects"]] == [
        ["b"],
        ["c"],
        ["operator"],
    ]
