from __future__ import annotations

import json
from contextlib import suppress

import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import ConfigError, Error
from mdm.team.transport.settings import address, check_endpoint, exposed, resolve, settings


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", "tls/robot1.local:1", "quic/10.0.0.1:65535", "tcp/[fe80::1%eth0]:7447",
     "tcp/0.0.0.0:7447#iface=eth0", "tcp/127.0.0.1:7447?prio=6-7", "unixsock-stream//tmp/robot1.sock"],
)  # fmt: skip
def test_endpoints_are_taken(endpoint):
    assert check_endpoint(endpoint) == endpoint


@pytest.mark.parametrize(
    "endpoint",
    ["", "tcp", "tcp/", "tcp/127.0.0.1", "tcp/127.0.0.1:", "tcp/127.0.0.1:x", "tcp/127.0.0.1:0", "tcp/:7447",
     "tcp/127.0.0.1:65536", "tcp/::1:7447", "http/127.0.0.1:80", "127.0.0.1:7447", "tcp/a/b:1",
     "unixsock-stream/robot1.sock", None, 7447],
)  # fmt: skip
def test_what_is_no_endpoint_is_refused_with_its_place(endpoint):
    with refused(ConfigError):
        check_endpoint(endpoint, key="team.agents")


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/0.0.0.1:1", "tcp/[::1]:1", "tcp/robot1:1",
     "tcp/0robot:1", "tcp/[fe80::1%eth0]:1", "unixsock-stream//0", "tcp/\0:1"],
)  # fmt: skip
def test_others_connect_to_one_machine(endpoint):
    assert check_endpoint(endpoint, connect=True) == endpoint


def test_every_address_of_a_machine_is_for_who_listens():
    assert check_endpoint("tls/[::]:7447#iface=eth0") == "tls/[::]:7447#iface=eth0"
    with refused(ConfigError):
        check_endpoint("tls/[::]:7447#iface=eth0", key="team.agents", connect=True)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("tcp/localhost:7447", "tls/127.0.0.1:7447?prio=6-7", True),
        ("tcp/Robot1:7447#iface=eth0", "ws/robot1:7447", True),
        ("tcp/robot1:7447", "quic/robot1:7447", False),
        ("tcp/robot1:7447", "tcp/robot1:7448", False),
        ("tcp/robot1:7447", "tcp/robot2:7447", False),
        ("unixsock-stream//tmp/a:1.sock", "unixsock-stream//tmp/b:1.sock", False),
        ("unixsock-stream//tmp/a.sock", "unixsock-stream//tmp/a.sock", True),
    ],
)
def test_a_port_of_a_host_is_one_program_s(one, other, same):
    assert (address(one) == address(other)) == same


def test_datagrams_are_refused_with_what_to_write_instead():
    with refused(ConfigError):
        check_endpoint("udp/10.0.0.1:7447", key="team.agents")


@given(st.text())
def test_any_text_is_an_endpoint_or_refused(text):
    with suppress(ConfigError):
        assert check_endpoint(text) == text


def test_hosts_are_looked_up():
    resolve("tcp/localhost:7447")
    resolve("tcp/[::1]:7447")
    resolve("unixsock-stream//tmp/robot1.sock")
    with refused(Error):
        resolve("tcp/robot.invalid:7447")


@pytest.mark.parametrize(
    ("endpoint", "others"),
    [
        ("tcp/127.0.0.1:7447", False),
        ("tcp/127.8.8.8:7447", False),
        ("tcp/localhost:7447", False),
        ("tcp/[::1]:7447", False),
        ("unixsock-stream//tmp/robot1.sock", False),
        ("tcp/0.0.0.0:7447", True),
        ("tls/[::]:7447", True),
        ("tcp/192.168.0.7:7447#iface=eth0", True),
        ("tcp/[fe80::1%eth0]:7447", True),
        ("quic/robot1.local:7447", True),
    ],
)
def test_endpoints_that_others_reach_are_named(endpoint, others):
    told = exposed(["tcp/127.0.0.1:1", endpoint])
    assert (told is not None) == others
    if told is not None:
        assert told.startswith(f"whoever reaches {endpoint} can speak as any agent")


def test_nobody_else_is_looked_for_or_let_in():
    made = settings(listen=["tcp/127.0.0.1:1"], connect=["tcp/127.0.0.1:2"], lease=0.5, largest=1 << 20)
    assert made["mode"] == "peer"
    assert made["scouting"] == {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    assert (made["listen"]["endpoints"], made["connect"]["endpoints"]) == (["tcp/127.0.0.1:1"], ["tcp/127.0.0.1:2"])
    assert made["transport"]["link"]["tx"]["lease"] == 500
    assert made["transport"]["shared_memory"] == {"enabled": False}


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_zenoh_takes_them(mode):
    zenoh = pytest.importorskip("zenoh")
    made = settings(listen=["tcp/127.0.0.1:1"], connect=["tcp/127.0.0.1:2"], lease=0.5, largest=1 << 20, mode=mode)
    taken = zenoh.Config.from_json5(json.dumps(made))
    assert json.loads(taken.get_json("transport/link/tx/lease")) == 500
    for opening in ("open_timeout", "accept_timeout"):
        assert json.loads(taken.get_json(f"transport/unicast/{opening}")) == 2000
