"""Which requests are answered: one change at a time of what a browser sends."""

from __future__ import annotations

import pytest
from sentences import refused

from mdm import Error
from mdm.views.web.access import Access

TOKEN = "a-secret-of-some-length"
HERE = "127.0.0.1:8765"


def asked(path="/", *, socket=False, **changes):
    """Return the status of a request that would be answered but for some changes; 0 where it is answered."""
    headers = {"Host": HERE, "Origin": f"http://{HERE}", "Cookie": f"other=1; mdm-8765={TOKEN}"} | changes
    headers = {name: value for name, value in headers.items() if value is not None}
    refusal = Access(8765, TOKEN).refusal(path, headers, socket=socket)
    return 0 if refusal is None else refusal.status


@pytest.mark.parametrize("host", [HERE, "localhost:8765", "[::1]:8765"])
def test_this_server_has_three_names(host):
    assert asked(Host=host) == 0
    assert asked(Host=host, Origin=f"http://{host}", socket=True) == 0


@pytest.mark.parametrize(
    "host",
    ["evil.example:8765", "127.0.0.1", "127.0.0.1:80", "127.0.0.1:8765.evil.example", "LOCALHOST:8765", "", None],
)
def test_a_name_that_leads_here_is_refused(host):
    assert asked(Host=host) == 421
    assert asked(Host=host, Origin=f"http://{host}", socket=True) == 421  # both are the attacker's
    assert asked(f"/?token={TOKEN}", Host=host) == 421


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:8765", f"http://{HERE}/", "", None]
)
def test_a_socket_opens_for_pages_of_this_server_alone(origin):
    assert asked(socket=True, Origin=origin) == 403
    assert asked(Origin=origin) == 0  # a browser sends none with a page


@pytest.mark.parametrize(
    "cookie",
    [
        None,
        "",
        "mdm-8765=",
        f"mdm-8766={TOKEN}",
        f"mdm-8765={TOKEN}x",
        f"mdm-8765={TOKEN[:-1]}",
        "mdm-8765=é",
        ";;=",
        "\0",
    ],
)
def test_what_brings_another_secret_is_refused(cookie):
    assert asked(Cookie=cookie) == 403
    assert asked(socket=True, Cookie=cookie) == 403
    assert asked(f"/?token={TOKEN}x", Cookie=cookie) == 403
    assert asked(f"/?token={TOKEN}", Cookie=cookie) == 0
    assert asked(f"/socket?token={TOKEN}", Cookie=cookie, socket=True) == 403  # an address may be seen; a cookie not


@pytest.mark.parametrize(
    ("port", "host"), [(8765, "robot.test:8765"), (8765, "[fd00::7]:8765"), (443, "robot.test"), (443, "[fd00::7]")]
)
def test_with_tls_a_server_has_the_names_that_are_given_and_no_others(port, host):
    access = Access(port, TOKEN, names=("robot.test", "fd00::7"))
    right = {"Host": host, "Origin": f"https://{host}", "Cookie": f"mdm-{port}={TOKEN}"}
    assert access.refusal("/socket", right, socket=True) is None
    for wrong, status in (
        ({"Origin": f"http://{host}"}, 403),
        ({"Origin": "https://127.0.0.1:8765"}, 403),
        ({"Host": "127.0.0.1:8765"}, 421),
        ({"Host": f"{host}:443"}, 421),
    ):
        assert access.refusal("/socket", right | wrong, socket=True).status == status
    assert access.address.startswith("https://robot.test")
    assert access.set_cookie.endswith("; Secure")


def test_a_refusal_does_not_say_which_part_was_wrong():
    access = Access(8765, TOKEN)
    right = {"Host": HERE, "Origin": f"http://{HERE}", "Cookie": f"mdm-8765={TOKEN}"}
    texts = {
        access.refusal("/socket", right | wrong, socket=True).text
        for wrong in ({"Origin": "http://evil.example"}, {"Cookie": ""}, {"Cookie": "mdm-8765=wrong"})
    }
    assert len(texts) == 1


def test_the_cookie_is_out_of_reach_for_scripts_and_other_sites():
    parts = {part.strip() for part in Access(8765, TOKEN).set_cookie.split(";")}
    assert parts == {f"mdm-8765={TOKEN}", "HttpOnly", "SameSite=Strict", "Path=/"}


def test_secrets_are_random_and_those_given_long_enough():
    assert Access(8765).token != Access(8765).token
    assert len(Access(8765).token) > 30
    for short in ("short", "with spaces in between", "schlüssel-schlüssel"):
        with refused(Error):
            Access(8765, short)
