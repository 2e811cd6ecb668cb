"""A page with TLS, asked over real sockets by clients that trust an authority, by others, and without TLS."""

from __future__ import annotations

import asyncio
import http.client
import socket
import ssl
from contextlib import closing, suppress

import pytest
from patience import PATIENCE
from sentences import refused
from served import TOKEN, get, port_of, shown
from transports import two_days_ago

from mdm import Error
from mdm.team.transport.access import Access
from mdm.team.transport.certificates import make_certificates
from mdm.views.web import Page
from mdm.views.web.access import encryption, trusting

websockets = pytest.importorskip("websockets")
pytest.importorskip("cryptography")


@pytest.fixture
def robot(tmp_path):
    """A certificate of a host that leads here by its address, and by a name that only the test knows."""
    return make_certificates(tmp_path / "robot", {"robot": ["127.0.0.1", "robot.test"]})["robot"]


def trusted(access):
    return ssl.create_default_context(cafile=access.authority)


async def ask(page, context, path="/", *, to="127.0.0.1", **headers):
    """Ask for a file over TLS; return the status, the headers and the body. A header that is None is left out."""

    def asked():
        port = port_of(page)
        connection = http.client.HTTPSConnection(to, port, timeout=PATIENCE, context=context)
        given = {"Host": f"127.0.0.1:{port}", "Cookie": f"mdm-{port}={TOKEN}"} | headers
        with closing(connection):
            connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
            for name, value in given.items():
                if value is not None:
                    connection.putheader(name, value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, dict(answer.headers), answer.read()

    return await asyncio.to_thread(asked)


def open_socket(page, context, *, host="127.0.0.1", origin=None, cookie=f"mdm-{{port}}={TOKEN}"):
    client = __import__("websockets.asyncio.client", fromlist=["connect"])
    port = port_of(page)
    return client.connect(
        f"wss://{host}:{port}/socket",
        host="127.0.0.1",
        port=port,
        ssl=context,
        origin=origin or f"https://{host}:{port}",
        additional_headers={"Cookie": cookie.format(port=port)},
    )


def test_its_address_begins_with_https_and_its_secret_goes_through_tls_alone(robot):
    async def main(_, page):
        port = port_of(page)
        assert page.address == f"https://127.0.0.1:{port}/?token={TOKEN}"
        status, headers, _ = await ask(page, trusted(robot), f"/?token={TOKEN}", Cookie=None)
        assert (status, headers["Location"]) == (303, "/")
        parts = {part.strip() for part in headers["Set-Cookie"].split(";")}
        assert parts == {f"mdm-{port}={TOKEN}", "HttpOnly", "SameSite=Strict", "Path=/", "Secure"}
        assert (await ask(page, trusted(robot)))[0] == 200
        async with open_socket(page, trusted(robot)) as browser:
            assert '"scene"' in await browser.recv()

    shown(main, host="127.0.0.1", access=robot)


def test_it_answers_to_the_names_of_its_certificate_and_to_no_other(robot):
    async def main(_, page):
        context, port = trusted(robot), port_of(page)
        for host, status in (
            ("robot.test", 200),
            ("127.0.0.1", 200),
            ("localhost", 421),  # which is not in the certificate
            ("evil.example", 421),
            ("robot.test.evil.example", 421),
        ):
            assert (await ask(page, context, Host=f"{host}:{port}"))[0] == status, host
        assert (await ask(page, context, Host="robot.test"))[0] == 421  # another port
        assert (await ask(page, context, Cookie=None))[0] == 403
        assert (await ask(page, context, "/?token=wrong", Cookie=None))[0] == 403
        async with open_socket(page, context, host="robot.test") as browser:
            assert '"scene"' in await browser.recv()
        for change in (
            {"origin": "https://evil.example"},
            {"origin": f"http://127.0.0.1:{port}"},  # a page that came in plain text
            {"origin": "https://127.0.0.1"},
            {"cookie": "mdm=1"},
        ):
            with pytest.raises(websockets.exceptions.InvalidStatus) as told:
                await open_socket(page, context, **change).__aenter__()
            assert told.value.response.status_code == 403

    shown(main, host="127.0.0.1", access=robot)


def test_who_trusts_another_authority_or_speaks_plainly_learns_nothing_and_the_robot_goes_on(robot, tmp_path):
    other = make_certificates(tmp_path / "other", {"robot": ["127.0.0.1"]})["robot"]

    async def main(runtime, page):
        for context in (trusted(other), ssl.create_default_context()):
            with pytest.raises(ssl.SSLCertVerificationError):
                await ask(page, context)
        old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        old.load_verify_locations(robot.authority)
        old.set_ciphers("ALL:@SECLEVEL=0")
        with pytest.warns(DeprecationWarning, match="TLSv1_1"):
            old.maximum_version = ssl.TLSVersion.TLSv1_1
        with pytest.raises((ssl.SSLError, ConnectionError)):
            await ask(page, old)
        with pytest.raises((http.client.HTTPException, ConnectionError)):
            await get(page, "/")
        for garbage in (b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\xff\xff" + b"\0" * 1000, b""):
            reader, writer = await asyncio.open_connection("127.0.0.1", port_of(page))
            writer.write(garbage)
            writer.write_eof()
            answer = b""
            with suppress(ConnectionError):
                answer = await reader.read()
            assert b"HTTP" not in answer
            writer.close()
        assert (await ask(page, trusted(robot)))[0] == 200
        assert runtime.root.life == "running"

    shown(main, host="127.0.0.1", access=robot)


def test_at_all_addresses_other_machines_reach_it_by_the_name_of_the_certificate(robot):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
        try:
            way.connect(("192.0.2.1", 9))  # nothing is sent
        except OSError:
            pytest.skip("this machine has the loopback address alone")
        here = way.getsockname()[0]

    async def main(_, page):
        port = port_of(page)
        assert page.address == f"https://robot.test:{port}/?token={TOKEN}"  # the loopback address is of no use to them
        context = trusted(robot)
        context.check_hostname = False  # as if the name led here
        assert (await ask(page, context, to=here, Host=f"robot.test:{port}"))[0] == 200
        assert (await ask(page, context, to=here, Host=f"{here}:{port}"))[0] == 421

    shown(main, host="0.0.0.0", access=robot)


def test_without_a_certificate_it_stays_on_its_machine():
    for host in ("0.0.0.0", "::", "robot.test", "192.0.2.1", "127.0.0.2", "localhost.evil.example"):
        with refused(Error):
            Page(0, host=host)
    for host in ("", None, 7, "..", "a" * 70):
        with refused(Error):
            Page(0, host=host)

    async def main(_, page):
        assert page.address.startswith("http://127.0.0.1:")

    shown(main, host="localhost")


def test_a_certificate_that_browsers_would_refuse_is_refused_first(robot, tmp_path):
    other = make_certificates(tmp_path / "other", {"robot": ["127.0.0.1"], "nobody": []})
    with two_days_ago():
        expired = make_certificates(tmp_path / "expired", {"robot": ["robot.test"]}, days=1)["robot"]
    for host, access, told in (
        ("other.test", robot, "robot.pem is a certificate of 127.0.0.1, robot.test, of which browsers would warn"),
        ("0.0.0.0", other["nobody"], "nobody.pem is a certificate of no host"),
        ("robot.test", expired, "certificate has expired"),
        ("robot.test", Access(robot.authority, robot.certificate, other["robot"].key), "is not the key to it"),
        ("127.0.0.1", Access(robot.authority, other["robot"].certificate, other["robot"].key), "others will not take"),
        ("robot.test", Access(robot.authority, robot.key, robot.key), "robot.key.pem is no certificate"),
        ("robot.test", Access(robot.key, robot.certificate, robot.key), "robot.key.pem is no certificate"),
        ("robot.test", Access(str(tmp_path / "none.pem"), robot.certificate, robot.key), "cannot read .*none.pem"),
        ("robot.test", Access(robot.authority, str(tmp_path), robot.key), "cannot read"),
        ("robot.test", "certificates/robot", "a page's access is an mdm.team.transport.access.Access"),
    ):
        with pytest.raises(Error, match=told) as raised:
            encryption(host, access)
        assert "\n" not in str(raised.value)
        assert "None" not in str(raised.value)


def test_names_are_those_of_the_certificate_and_a_star_stands_for_one_part(tmp_path):
    made = make_certificates(
        tmp_path, {"lab": ["127.0.0.1", "*.lab.test", "Robot.test", "::1"], "stars": ["*.lab.test"]}
    )
    assert encryption("0.0.0.0", made["lab"]).names == ("robot.test", "127.0.0.1", "::1")
    assert encryption("[::1]", made["lab"]).names == ("::1", "127.0.0.1", "robot.test")
    assert encryption("R7.lab.test", made["lab"]).names == ("r7.lab.test", "127.0.0.1", "robot.test", "::1")
    for host, access in (("a.b.lab.test", made["lab"]), ("lab.test", made["lab"]), ("0.0.0.0", made["stars"])):
        with pytest.raises(Error, match="of which browsers would warn"):
            encryption(host, access)


def test_a_client_trusts_one_authority_alone(robot, tmp_path):
    assert len(trusting(robot.authority).get_ca_certs()) == 1
    for wrong, told in ((robot.key, "robot.key.pem is no certificate"), (str(tmp_path / "none.pem"), "cannot read")):
        with pytest.raises(Error, match=told):
            trusting(wrong)
