"""Certificates to try a team with: an authority, and a certificate of each agent.

They are made by the package ``cryptography`` (``pip install cryptography``): the rules of
X.509 are no place for code of one's own, and the program ``openssl`` differs from one machine to the next. A team in
earnest takes its certificates from whoever keeps its keys.
"""

from __future__ import annotations

import datetime as dt
import ipaddress
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.errors import Error
from mdm.team.transport.access import access_of
from mdm.team.transport.keys import check_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mdm.team.transport.access import Access

_MOST_DAYS = 36_500
_AUTHORITY_DAYS = 3_650


def make_certificates(folder: str | Path, agents: Mapping[str, Sequence[str]], *, days: int = 30) -> dict[str, Access]:
    """Write an authority's certificate, and of each agent a certificate and its key; return where they are.

    In a folder that has an authority already, it signs for those who have no certificate yet; what is there stays. So
    an agent that comes later changes nothing for the others, and who removes the two files of an agent renews it. The
    key of the authority, ``authority.key.pem``, is for no robot.

    Args:
        folder: Where to write; it is made where it is not.
        agents: The hosts of each agent's endpoints, by name.
        days: How long they are valid; the authority is for ten years at least.

    Raises:
        Error: If ``cryptography`` is not installed, all files are there already or one cannot be written, the authority
            there cannot sign, two files would have one name, or the days are more than a hundred years.
    """
    if not 1 <= days <= _MOST_DAYS:
        raise Error(f"certificates are valid for 1 to {_MOST_DAYS} days, not for {days}")
    try:
        from cryptography import x509  # noqa: PLC0415 - an extra
        from cryptography.hazmat.primitives import hashes  # noqa: PLC0415
        from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415
    except ImportError:
        raise Error("certificates need the package cryptography: pip install cryptography") from None
    place = Path(folder)
    made = {check_name(agent, "an agent"): access_of(place, agent) for agent in agents}
    _check_files(made)
    missing = [agent for agent, own in made.items() if not Path(own.certificate).exists()]
    if not missing:
        raise Error(f"all certificates for {place} are there already: name another folder, or remove some first")
    now = dt.datetime.now(dt.UTC)

    def certificate(
        name: str, public: Any, issuer: Any, signer: Any, hosts: Sequence[str], days: int, *, authority: bool = False
    ) -> Any:
        builder = (
            x509.CertificateBuilder()
            .subject_name(x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)]))
            .issuer_name(issuer)
            .public_key(public)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - dt.timedelta(hours=1))
            .not_valid_after(now + dt.timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=authority, path_length=None), critical=True)
            .add_extension(_usage(x509, authority=authority), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), critical=False)
        )
        if not authority:
            uses = [x509.oid.ExtendedKeyUsageOID.SERVER_AUTH, x509.oid.ExtendedKeyUsageOID.CLIENT_AUTH]
            builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        if hosts:
            builder = builder.add_extension(x509.SubjectAlternativeName([_host(x509, host) for host in hosts]), False)
        return builder.sign(signer, hashes.SHA256())

    files = access_of(place, "authority")
    if Path(files.authority).exists():
        issuer, root = _authority(files)
    else:
        name = "authority of a team that is tried"
        issuer = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
        root = ec.generate_private_key(ec.SECP256R1())
        own = certificate(name, root.public_key(), issuer, root, (), max(days, _AUTHORITY_DAYS), authority=True)
        _write(files.key, _key_pem(root), secret=True)
        _write(files.authority, _pem(own), secret=False)
    for agent in missing:
        key = ec.generate_private_key(ec.SECP256R1())
        own = certificate(agent, key.public_key(), issuer, root, agents[agent], days)
        _write(made[agent].key, _key_pem(key), secret=True)
        _write(made[agent].certificate, _pem(own), secret=False)
    return made


def _authority(files: Access) -> tuple[Any, Any]:
    """Return the name and the key of an authority that is there.

    Raises:
        Error: If it cannot sign.
    """
    from cryptography import x509  # noqa: PLC0415 - an extra
    from cryptography.hazmat.primitives.serialization import load_pem_private_key  # noqa: PLC0415

    with suppress(OSError, ValueError, TypeError):
        own = x509.load_pem_x509_certificate(Path(files.certificate).read_bytes())
        key: Any = load_pem_private_key(Path(files.key).read_bytes(), None)
        if key.public_key() == own.public_key():
            return own.subject, key
    raise Error(
        f"{files.certificate} is there already, and {files.key} is no key to it, to sign more with: name another "
        "folder, or bring that key"
    )


def _check_files(agents: Iterable[str]) -> None:
    """Raise an error where two files would have one name, before any is written."""
    whose = {"authority.pem": "the authority's certificate", "authority.key.pem": "the authority's key"}
    for agent in agents:
        for file, kind in ((f"{agent}.pem", "certificate"), (f"{agent}.key.pem", "key")):
            if file in whose:
                raise Error(f"no certificate for agent {agent!r}: {whose[file]} is {file}; give the agent another name")
            whose[file] = f"the {kind} of agent {agent!r}"


def _usage(x509: Any, *, authority: bool) -> Any:
    """Return the use of a key: to sign certificates, or the messages of a handshake."""
    others = ("content_commitment", "key_encipherment", "data_encipherment", "key_agreement")
    return x509.KeyUsage(
        **dict.fromkeys(others, False),
        digital_signature=not authority,
        key_cert_sign=authority,
        crl_sign=authority,
        encipher_only=False,
        decipher_only=False,
    )


def _host(x509: Any, host: str) -> Any:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        return x509.DNSName(host)


def _pem(certificate: Any) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding  # noqa: PLC0415 - an extra

    pem: bytes = certificate.public_bytes(Encoding.PEM)
    return pem


def _key_pem(key: Any) -> bytes:
    from cryptography.hazmat.primitives.serialization import (  # noqa: PLC0415 - an extra
        Encoding,
        NoEncryption,
        PrivateFormat,
    )

    pem: bytes = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return pem


def _write(name: str, content: bytes, *, secret: bool) -> None:
    path = Path(name)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "that is no folder" if isinstance(error, FileExistsError) else error.strerror
        raise Error(f"cannot write to {path.parent}: {reason}") from None
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if secret else 0o644)
    except FileExistsError:
        raise Error(f"{path} is there already: name another folder, or remove it first") from None
    except OSError as error:
        raise Error(f"cannot write {path}: {error.strerror}") from None
    try:
        with os.fdopen(descriptor, "wb") as written:
            written.write(content)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise Error(f"cannot write {path}: {error.strerror}") from None
