"""Who may look at a page: a page shows a robot, and may command it, so that every request is checked.

Other pages of the same browser are the danger: they may send requests here, and by names of their own that they let
lead here (DNS rebinding). So a request has to name this server, a socket has to be opened by a page of this server, and
both need a secret that only the printed address has told. No request but a message on the socket does anything.
"""

from __future__ import annotations

import hmac
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import parse_qs, urlsplit

from mdm.errors import Error
from mdm.views.web.listening import LOOPBACK

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["HEADERS", "Access", "Refusal"]

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

_LEAST = 16
_REFUSED = "This page opens by the address that its program has printed.\n"


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
            path: The path, with what is asked.
            headers: The headers, each of which is there once at most.
            socket: Whether a socket is to be opened.
        """
        if not self.names_us(headers):
            return Refusal(421, "This server has another name.\n")
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
