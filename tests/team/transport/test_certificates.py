from __future__ import annotations

import errno
import io
import os
import ssl
import stat
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from sentences import refused

from mdm.errors import ConfigError, Error
from mdm.team.transport.certificates import make_certificates


def test_each_agent_gets_a_certificate_of_one_authority(tmp_path):
    x509 = pytest.importorskip("cryptography.x509")
    made = make_certificates(tmp_path / "new", {"robot1": ["127.0.0.1", "robot1.local"], "robot2": ["[::1]"]})
    assert list(made) == ["robot1", "robot2"]
    authority = x509.load_pem_x509_certificate(Path(made["robot1"].authority).read_bytes())
    for agent, access in made.items():
        own = x509.load_pem_x509_certificate(Path(access.certificate).read_bytes())
        own.verify_directly_issued_by(authority)
        assert own.subject.rfc4514_string() == f"CN={agent}"
        assert stat.S_IMODE(Path(access.key).stat().st_mode) == 0o600
    hosts = x509.load_pem_x509_certificate(Path(made["robot1"].certificate).read_bytes())
    names = hosts.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(name.value) for name in names] == ["127.0.0.1", "robot1.local"]


def test_who_is_strict_about_certificates_trusts_them_too(tmp_path):
    """Python itself is from 3.13 on, as browsers are."""
    pytest.importorskip("cryptography")
    made = make_certificates(tmp_path, {"robot1": ["127.0.0.1", "robot1.local"]})["robot1"]
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(made.certificate, made.key)
    for name in ("robot1.local", "127.0.0.1"):
        client = ssl.create_default_context(cafile=made.authority)
        client.verify_flags |= ssl.VERIFY_X509_STRICT
        there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
        ends = [client.wrap_bio(back, there, server_hostname=name), server.wrap_bio(there, back, server_side=True)]
        for _ in range(4):
            for end in ends:
                with suppress(ssl.SSLWantReadError):
                    end.do_handshake()
        assert ends[0].getpeercert()["subjectAltName"] == (("IP Address", "127.0.0.1"), ("DNS", "robot1.local"))


def test_nothing_is_written_over(tmp_path):
    pytest.importorskip("cryptography")
    make_certificates(tmp_path, {"a": []})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with refused(Error):
        make_certificates(tmp_path, {"a": []})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_key_of_the_authority_is_a_secret(tmp_path):
    pytest.importorskip("cryptography")
    make_certificates(tmp_path, {"a": []})
    assert stat.S_IMODE((tmp_path / "authority.key.pem").stat().st_mode) == 0o600


def test_who_lost_both_files_gets_new_ones_and_who_lost_one_is_told(tmp_path):
    pytest.importorskip("cryptography")
    made = make_certificates(tmp_path, {"a": [], "b": []})
    before = {agent: Path(own.certificate).read_bytes() for agent, own in made.items()}
    Path(made["a"].certificate).unlink()
    with refused(Error):
        make_certificates(tmp_path, {"a": [], "b": []})
    Path(made["a"].key).unlink()
    make_certificates(tmp_path, {"a": [], "b": []})
    assert [Path(own.certificate).read_bytes() == before[agent] for agent, own in made.items()] == [False, True]


@pytest.mark.parametrize("key", [None, "another's", "garbage"])
def test_an_authority_that_cannot_sign_is_told(tmp_path, key):
    pytest.importorskip("cryptography")
    make_certificates(tmp_path, {"a": []})
    own = tmp_path / "authority.key.pem"
    if key is None:
        own.unlink()
    else:
        own.write_bytes((tmp_path / "a.key.pem").read_bytes() if key == "another's" else b"garbage")
    with pytest.raises(Error) as told:
        make_certificates(tmp_path, {"a": [], "b": []})
    assert str(told.value) == (
        f"{tmp_path}/authority.pem is there already, and {own} is no key to it, to sign more with: name another "
        "folder, or bring that key"
    )


def test_names_that_are_paths_are_refused(tmp_path):
    pytest.importorskip("cryptography")
    with refused(ConfigError):
        make_certificates(tmp_path, {"../a": []})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("agents", "told"),
    [
        (["left", "authority"], r"for agent 'authority': the authority's certificate is authority\.pem"),
        (["authority.key"], r"for agent 'authority\.key': the authority's key is authority\.key\.pem"),
        (["a", "a.key"], r"for agent 'a\.key': the key of agent 'a' is a\.key\.pem"),
        (["a.key", "a"], r"for agent 'a': the certificate of agent 'a\.key' is a\.key\.pem"),
    ],
)
def test_names_whose_files_would_be_one_are_refused_before_anything_is_written(agents, told, tmp_path):
    pytest.importorskip("cryptography")
    with pytest.raises(Error, match=told):
        make_certificates(tmp_path, {agent: [] for agent in agents})
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    pytest.importorskip("cryptography")
    (tmp_path / "file").write_text("")
    with refused(Error):
        make_certificates(tmp_path / "file" / "folder", {"a": []})


def test_a_disk_that_is_full_is_told_with_the_file(tmp_path, monkeypatch):
    pytest.importorskip("cryptography")
    fdopen = os.fdopen

    class Full(io.BytesIO):
        def write(self, content):
            raise OSError(errno.ENOSPC, "No space left on device")

    def opened(descriptor, mode):
        fdopen(descriptor, mode).close()
        return Full()

    monkeypatch.setattr("mdm.team.transport.certificates.os.fdopen", opened)
    with refused(Error):
        make_certificates(tmp_path, {"a": []})
    assert list(tmp_path.iterdir()) == []


def test_without_the_package_it_is_said_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    with refused(Error):
        make_certificates(tmp_path, {"a": []})
