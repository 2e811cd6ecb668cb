"""Who may look at a page: a page shows a robot, and may command it, so that every request is checked.

Other pages of the same browser are the danger: they may send requests here, and by names of their own that they let
lead here (DNS rebinding). So a request has to name this server, a socket has to be opened by a page of this server, and
both need a secret that only the printed address has told. No request but a message on the socket does anything.

A page that is opened to other machines is encrypted by TLS, with a certificate of the team's authority. Who looks shows
none, since browsers seldom have one: the secret of the page's address lets in, and goes through TLS alone. A
page answers to the names in its certificate, and to no other.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import ssl
from contextlib import suppress
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from mdm.errors import Error
from mdm.team.transport.access import Access as Certificate, shown_certificate
from mdm.views.web.listening import LOOPBACK, is_loopback

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Sent with every answer: nothing but this server's own files is loaded, and no other page may frame one."""

METRICS = "/metrics"
"""The path that programs ask, which keep no cookie: they bring the secret by a header of their own."""

_LEAST = 16
_REFUSED = "This page opens by the address that its program has printed.\n"
_UNKNOWN = "Metrics need this page's token: 'Authorization: Bearer TOKEN'; MDM_PAGE_TOKEN sets it.\n"
_EVERYWHERE = ("0.0.0.0", "::")  # noqa: S104 - where a page listens only with certificates


class Refusal(NamedTuple):
    """Why a request is not answered: an HTTP status, and a sentence that says no more than it must."""

    status: int
    text: str


class Access:
    """Decides which requests are answered.

    Args:
        port: The port of the server.
        token: The secret; by default a random one.
        names: The hosts by which the server is addressed through TLS, the one to print first; none for a server of the
            loopback addresses, without TLS.

    Raises:
        Error: If the secret is too short to be one, or has other characters than an address may have.
    """

    def __init__(self, port: int, token: str | None = None, *, names: Sequence[str] = ()) -> None:
        if token is not None and not (
            len(token) >= _LEAST and token.isascii() and token.replace("-", "_").isidentifier()
        ):
            raise Error(f"the token of a page has {_LEAST} or more letters, digits, - and _, and begins with a letter")
        self.token = "t" + secrets.token_urlsafe(24) if token is None else token
        self.cookie = f"mdm-{port}"
        scheme, usual = ("https", 443) if names else ("http", 80)
        hosts = [f"[{name}]" if ":" in name else name for name in names or LOOPBACK]
        hosts = hosts if port == usual else [f"{host}:{port}" for host in hosts]  # as browsers write them
        self._hosts = frozenset(hosts)
        self._origins = frozenset(f"{scheme}://{host}" for host in hosts)
        self._secure = "; Secure" if names else ""
        self.address = f"{scheme}://{hosts[0]}/?token={self.token}"

    def names_us(self, headers: Mapping[str, str]) -> bool:
        """Whether a request names this server as its host."""
        return headers.get("Host", "") in self._hosts

    def refusal(self, path: str, headers: Mapping[str, str], *, socket: bool) -> Refusal | None:
        """Return why a request is refused; None where it is answered.

        Args:
            path: The path, with its query.
            headers: The headers, each of which is there once at most.
            socket: Whether a socket is to be opened.
        """
        if not self.names_us(headers):
            return Refusal(421, "This server has another name.\n")
        if urlsplit(path).path == METRICS:
            scheme, _, given = headers.get("Authorization", "").partition(" ")
            return None if scheme.lower() == "bearer" and self._is_token(given.strip()) else Refusal(401, _UNKNOWN)
        if socket and headers.get("Origin", "") not in self._origins:
            return Refusal(403, _REFUSED)
        if not self._is_known(headers) and (socket or not self.brings_token(path)):
            return Refusal(403, _REFUSED)
        return None

    def brings_token(self, path: str) -> bool:
        """Whether a path has the secret."""
        given = parse_qs(urlsplit(path).query).get("token", [""])
        return self._is_token(given[0])

    def _is_known(self, headers: Mapping[str, str]) -> bool:
        cookies: SimpleCookie = SimpleCookie()
        try:
            cookies.load(headers.get("Cookie", ""))
        except CookieError:
            return False
        return self.cookie in cookies and self._is_token(cookies[self.cookie].value)

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="replace"), self.token.encode())

    @property
    def set_cookie(self) -> str:
        """The header that lets a browser bring the secret from now on, to this server alone."""
        return f"{self.cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/{self._secure}"


class Encryption(NamedTuple):
    """How a page is encrypted, where it is.

    Attributes:
        host: Where it listens.
        context: The context of its server; None for a page of this machine alone, in plain text.
        names: The hosts by which it is addressed through TLS, the one to print first.
    """

    host: str
    context: ssl.SSLContext | None = None
    names: tuple[str, ...] = ()


def encryption(host: object, access: object) -> Encryption:
    """Return the encryption of a page.

    Args:
        host: A name or an address; ``0.0.0.0`` for all addresses of this machine.
        access: The certificate that is shown there, its key, and the authority that those trust who look; None for a
            page of this machine alone.

    Raises:
        ConfigError: If a file is missing or is none, the key is another certificate's, or those who trust the authority
            would not trust the certificate, such as one that has expired.
        Error: If the host is none, would be reached by other machines without a certificate, or is not in it.
    """
    name = _address(host) or _encoded(host) if isinstance(host, str) else ""
    if not name:
        raise Error(f"a page's host is a name or an address, such as 'robot.local' or '0.0.0.0', not {host!r}")
    if access is None:
        if name not in LOOPBACK:
            raise Error(
                f"a page for other machines needs TLS: for host {host!r} give its certificate, by Page(access=) "
                "or --page-access FOLDER/NAME, or leave the host out and look through a tunnel (ssh -L)"
            )
        return Encryption(name)
    if not isinstance(access, Certificate):
        raise Error(f"a page's access is an mdm.team.transport.access.Access with its certificate, not {access!r}")
    names = _names(access, name)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(access.certificate, access.key, password="")
    return Encryption(name, context, tuple(names))


def _names(access: Certificate, host: str) -> list[str]:
    """Return the hosts by which a page is addressed."""
    shown: Any = shown_certificate(access).get("subjectAltName", ())
    given = [_address(name) or name.lower() for kind, name in shown if kind in {"DNS", "IP Address"}]
    exact = [name for name in given if "*" not in name]
    if host in _EVERYWHERE and exact:
        return sorted(exact, key=is_loopback)
    if host in given or f"*.{host.partition('.')[2]}" in given:  # a star stands for the first part of a name
        return [host, *(name for name in exact if name != host)]
    raise Error(
        f"{access.certificate} is a certificate of {', '.join(given) or 'no host'}, of which browsers would warn: have "
        f"one made that names {'a host' if host in _EVERYWHERE else host} (its subject alternative name), as "
        "`mdm team certificates --host NAME` does"
    )


def trusting(authority: str | None) -> ssl.SSLContext:
    """Return the context of a client.

    Args:
        authority: The file of the only authority that it trusts; None for those that this machine trusts.

    Raises:
        Error: If the file cannot be read, or is no certificate.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    if authority is None:
        context.load_default_certs()
        return context
    try:
        context.load_verify_locations(authority)
    except ssl.SSLError as error:
        raise Error(f"{authority} is no certificate ({error.reason})") from None
    except OSError as error:
        raise Error(f"cannot read {authority}: {error.strerror}") from None
    return context


def _address(name: str) -> str | None:
    """Return an address in its usual form; None where it is none."""
    with suppress(ValueError):
        return str(ipaddress.ip_address(name.strip("[]\n")))
    return None


def _encoded(name: str) -> str:
    """Return a name as browsers send it; empty where it is none."""
    with suppress(UnicodeError):
        return name.encode("idna").decode("ascii").lower()
    return ""
