"""Certificates that are renewed beneath a session that is open: what Zenoh takes up, and when."""

from __future__ import annotations

import asyncio
import shutil
import socket
import ssl
from pathlib import Path

import pytest
from patience import PATIENCE
from transports import Loopback, endpoint, routing

from mdm.team.transport.access import access_settings
from mdm.team.transport.certificates import make_certificates
from mdm.team.transport.session import Session

pytest.importorskip("zenoh")
pytest.importorskip("cryptography", reason="makes the certificates")

AGENTS = ["a", "b"]


class Files:
    """The certificates of two agents and a router, which are renewed by the same authority."""

    def __init__(self, folder):
        self.folder = folder
        self.names = dict.fromkeys((*AGENTS, "router"), ("127.0.0.1",))
        self.own = make_certificates(folder, self.names)

    def renew(self):
        for name in self.names:
            shutil.move(self.own[name].certificate, f"{self.own[name].certificate}.old")
            shutil.move(self.own[name].key, f"{self.own[name].key}.old")
        make_certificates(self.folder, self.names)

    def certificate(self, name, suffix=""):
        return ssl.PEM_cert_to_DER_cert(Path(f"{self.own[name].certificate}{suffix}").read_text())


@pytest.fixture
def files(tmp_path):
    return Files(tmp_path)


def run(main, files):
    async def within():
        net = Loopback(files=files.own, agents=AGENTS)
        try:
            await main(net)
        finally:
            await net.close()

    asyncio.run(within())


def shown_at(where, files):
    """Return the certificate that whoever listens there shows to agent b."""
    host, _, port = where.partition("/")[2].rpartition(":")
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.load_verify_locations(files.own["b"].authority)
    client.load_cert_chain(files.own["b"].certificate, files.own["b"].key)
    with socket.create_connection((host, int(port))) as plain, client.wrap_socket(plain, server_hostname=host) as shown:
        return shown.getpeercert(binary_form=True)


def shown_to(where, files):
    """Listen there as the router, and return the certificate that whoever connects shows."""
    host, _, port = where.partition("/")[2].rpartition(":")
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(files.own["router"].certificate, files.own["router"].key)
    server.load_verify_locations(files.own["router"].authority)
    server.verify_mode = ssl.CERT_REQUIRED
    with socket.create_server((host, int(port)), reuse_port=False) as listening:
        listening.settimeout(PATIENCE)
        plain, _ = listening.accept()
        with server.wrap_socket(plain, server_side=True) as shown:
            return shown.getpeercert(binary_form=True)


def test_who_listens_shows_what_was_there_at_its_start(files):
    async def main(net):
        where = endpoint(protocol="tls")
        a = net.transport("a", listen=where)
        await a.open()
        files.renew()
        assert await asyncio.to_thread(shown_at, where, files) == files.certificate("a", ".old")
        await a.close()
        await net.transport("a", listen=where).open()
        assert (
            await asyncio.to_thread(shown_at, where, files) == files.certificate("a") != files.certificate("a", ".old")
        )

    run(main, files)


def test_who_connects_again_shows_what_is_there_by_then(files):
    async def main(net):
        where = endpoint(protocol="tls")
        shown = access_settings(files.own["b"], "team", "b", AGENTS, routed=True)
        b = Session("team", "b", listen=[], connect=[where], mode="client", lease=2.0, configuration=shown)
        net.made.append(b)
        with routing(where, files.own["router"], AGENTS):
            await b.open()
        files.renew()
        assert (
            await asyncio.to_thread(shown_to, where, files) == files.certificate("b") != files.certificate("b", ".old")
        )
        with routing(where, files.own["router"], AGENTS):
            a = Session(
                "team", "a", listen=[], connect=[where], mode="client", lease=2.0,
                configuration=access_settings(files.own["a"], "team", "a", AGENTS, routed=True),
            )  # fmt: skip
            net.made.append(a)
            await net.open(a)
            await net.until(lambda: "a" in b._tokens)

    run(main, files)
