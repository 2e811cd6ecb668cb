"""The encryption of a page that is opened to other machines: TLS, with a certificate of the team's authority.

Who looks shows no certificate, since browsers seldom have one: the secret of the page's address is what lets in, and
goes through TLS alone. A page answers to the names in its certificate, and to no other.
"""

from __future__ import annotations

import ipaddress
import ssl
from contextlib import suppress
from typing import Any, NamedTuple

from mdm.errors import Error
from mdm.team.transport.access import Access, shown_certificate
from mdm.views.web.listening import LOOPBACK, is_loopback

__all__ = ["Encryption", "encryption", "trusting"]

_EVERYWHERE = ("0.0.0.0", "::")  # noqa: S104 - where a page listens only with certificates


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
                f"a page leaves this machine with TLS alone: for host {host!r} give its certificate, by Page(access=) "
                "or --page-access FOLDER/NAME, or leave the host out and look through a tunnel (ssh -L)"
            )
        return Encryption(name)
    if not isinstance(access, Access):
        raise Error(f"a page's access is an mdm.team.transport.access.Access with its certificate, not {access!r}")
    names = _names(access, name)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(access.certificate, access.key, password="")
    return Encryption(name, context, tuple(names))


def _names(access: Access, host: str) -> list[str]:
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
    """Return an address in its usual form; None for what is none."""
    with suppress(ValueError):
        return str(ipaddress.ip_address(name.strip("[]\n")))
    return None


def _encoded(name: str) -> str:
    """Return a name as browsers send it; empty where it is none."""
    with suppress(UnicodeError):
        return name.encode("idna").decode("ascii").lower()
    return ""
