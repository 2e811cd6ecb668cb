"""Access: who may talk to a team, and under which keys; Zenoh keeps both.

Agents show each other certificates of one authority, whose common names are the agents' names. Of an agent that shows
one, Zenoh lets through the messages under its own keys, and drops the rest. Envelopes are checked besides, with or
without this.
"""

from __future__ import annotations

import ssl
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.errors import ConfigError
from mdm.runtime import Actor
from mdm.team.transport.keys import ROOT, check_name, join

if TYPE_CHECKING:
    from collections.abc import Sequence

OPERATOR = "operator"
"""Whose certificate somebody shows who is none of the agents: it lets them ask and call, and put nothing."""

ROUTER = "router"
"""Whose certificate a router shows, through which agents hear each other: what others say comes from it."""

_OWN = ("put", "delete", "reply", "declare_queryable", "liveliness_token")
_ANY = ("declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber")


WARNING = 7.0
"""Days before its end at which a certificate is noted by who looks."""

_LAST = 2.0  # days before it at which the running team reports it
_PAUSE = 6 * 3600.0


class Access(msgspec.Struct, frozen=True):
    """The certificate of an agent, and the authority that it trusts: paths of files in PEM form.

    Args:
        authority: The certificate of the authority that signed those of all agents.
        certificate: The agent's own certificate; its common name is the agent's name.
        key: The private key to it.
    """

    authority: str
    certificate: str
    key: str


def access_of(folder: Path, name: str) -> Access:
    """Return the paths of a name's certificate in a folder of them."""
    return Access(*(str(folder / file) for file in ("authority.pem", f"{name}.pem", f"{name}.key.pem")))


def access_settings(
    access: Access, team: str, agent: str, agents: Sequence[str], *, routed: bool = False
) -> dict[str, Any]:
    """Return Zenoh's settings for mutual TLS and the permissions of each agent.

    Args:
        access: The agent's files.
        team: The team's name.
        agent: The agent's own name.
        agents: The names of all agents.
        routed: Whether a router stands between them: it keeps each to its own keys, and is believed.

    Raises:
        ConfigError: If a file is missing or is none, others would refuse the certificate as this agent's, or an agent
            has the operator's name, or a router's.
    """
    for name, who in ((OPERATOR, "whoever asks the team"), *([(ROUTER, "its router")] if routed else [])):
        if name in agents:
            raise ConfigError(
                f"with access no agent can be called {name!r}: {who} shows a certificate of that name", key="agents"
            )
    _check_certificate(access, agent)
    others = [name for name in agents if name != agent]
    # Zenoh forbids what no rule allows: to send anything of the team's, and to take what anyone may ask and hear.
    rules = [
        _rule("all", ["egress"], (*_OWN, *_ANY), [f"{ROOT}/{team}/**", *_whole(team, "*")]),
        _rule("ask", ["ingress"], _ANY, [f"{ROOT}/{team}/**", *_whole(team, "*")]),
    ]
    policies, subjects = [], []
    for name in others:
        check_name(name, "an agent")
        rules.append(_rule(f"own {name}", ["ingress"], _OWN, _whole(team, name)))
        subjects.append({"id": name, "cert_common_names": [name]})
        policies.append({"rules": ["all", "ask", f"own {name}"], "subjects": [name]})
    subjects.append({"id": OPERATOR, "cert_common_names": [OPERATOR]})
    policies.append({"rules": ["all", "ask"], "subjects": [OPERATOR]})
    if routed:
        subjects = [{"id": ROUTER, "cert_common_names": [ROUTER]}]
        policies = [{"rules": [rule["id"] for rule in rules], "subjects": [ROUTER]}]
    return {
        "transport": {
            "link": {
                "protocols": ["tls"],
                "tls": {
                    "root_ca_certificate": access.authority,
                    "listen_certificate": access.certificate,
                    "listen_private_key": access.key,
                    "connect_certificate": access.certificate,
                    "connect_private_key": access.key,
                    "enable_mtls": True,
                    "verify_name_on_connect": True,
                },
            }
        },
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        },
    }


def _check_certificate(access: Access, agent: str) -> None:
    """Refuse a certificate that others would refuse as this agent's.

    Raises:
        ConfigError: If they would.
    """
    subject = shown_certificate(access).get("subject", ())
    names = [value for part in subject for kind, value in part if kind == "commonName"]
    if agent not in names:
        raise ConfigError(
            f"{access.certificate} is of {', '.join(names) or 'nobody'}, not of agent {agent!r}",
            key="access.certificate",
        )


def shown_certificate(access: Access) -> dict[str, Any]:
    """Return what others see of a certificate, as `ssl.SSLSocket.getpeercert` does, by shaking hands with oneself.

    Others tell nothing of why they refuse one: so what they would refuse is found here, and named.

    Raises:
        ConfigError: If a file is missing or is none, the key is another certificate's, or those who trust the authority
            would not trust the certificate, such as one that has expired.
    """
    for what, path in (("authority", access.authority), ("certificate", access.certificate), ("key", access.key)):
        try:
            Path(path).read_bytes()
        except OSError as error:
            raise ConfigError(
                f"cannot read {path}: {error.strerror}; `mdm team certificates` makes files to try",
                key=f"access.{what}",
            ) from None
    server, client = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname = False
    try:
        server.load_cert_chain(
            access.certificate, access.key, password=""
        )  # an encrypted key is refused, not asked for
    except ssl.SSLError as error:
        reason = f" ({error.reason})" if error.reason else ""
        raise ConfigError(
            f"{access.certificate} is no certificate, or {access.key} is not the key to it{reason}",
            key="access.certificate",
        ) from None
    try:
        client.load_verify_locations(access.authority)
    except ssl.SSLError as error:
        raise ConfigError(f"{access.authority} is no certificate ({error.reason})", key="access.authority") from None
    there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [client.wrap_bio(back, there), server.wrap_bio(there, back, server_side=True)]
    for _ in range(4):
        for end in ends:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
            except ssl.SSLCertVerificationError as error:
                raise ConfigError(
                    f"others will not take {access.certificate} for one of {access.authority}: {error.verify_message}",
                    key="access.certificate",
                ) from None
    shown: dict[str, Any] = ends[0].getpeercert() or {}
    return shown


def valid_until(access: Access) -> float:
    """Return until when a certificate, and that of the authority which signed it, are valid, in seconds since 1970.

    Raises:
        ConfigError: As `shown_certificate`.
    """
    shown = shown_certificate(access)
    authority = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    authority.load_verify_locations(access.authority)
    signers = [one for one in authority.get_ca_certs() if one["subject"] == shown["issuer"]]
    end, *ends = (ssl.cert_time_to_seconds(str(one["notAfter"])) for one in (shown, *signers))
    return min(end, max(ends, default=end))


def _whole(team: str, agent: str) -> list[str]:
    return [join(team, agent, "**"), join(team, agent, "@team", "**")]


def _rule(name: str, flows: Sequence[str], messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    return {"id": name, "flows": flows, "messages": messages, "permission": "allow", "key_exprs": keys}


def days_left(access: Access | None) -> float | None:
    """Return for how many days certificates are valid that lie here, and are valid; None where there are none."""
    with suppress(ConfigError):  # who uses them is told
        return None if access is None else (valid_until(access) - time.time()) / 86400
    return None


def ending(days: float, agent: str) -> str:
    """Say when a certificate ends."""
    when = f"ends in {days:.1f} days" if days > 0 else "has ended"
    return f"the certificate of {agent!r}, or of the authority that signed it, {when}"


class Validity(Actor):
    """Reports a fault ``certificate`` in the last two days of an agent's certificates, every six hours.

    Zenoh reads their files whenever it connects; those for agents that connect to it, at its start alone.

    Args:
        access: The files.
        agent: Whose they are.
        listens: Whether others connect to the agent.
    """

    def __init__(self, access: Access, agent: str, *, listens: bool) -> None:
        super().__init__("certificate")
        self._access = access
        self._agent = agent
        self._listens = listens
        self._until = valid_until(access)

    @property
    def days(self) -> float:
        """For how many days the certificates that the agent shows are valid."""
        if not self._listens:
            with suppress(ConfigError):  # they have ended, or are being written
                self._until = valid_until(self._access)
        return (self._until - time.time()) / 86400

    def on_running(self) -> None:
        """Look, and look again later."""
        if self.days < _LAST:
            taken = "is started again" if self._listens else "connects to its router again"
            told = "renew the files, for then nobody reconnects; this agent takes them up when it"
            self.report("certificate", f"{ending(self.days, self._agent)}: {told} {taken}")
        self.call_later(_PAUSE, self.on_running)
