"""`mdm team certificates`: files to try a team with."""

from __future__ import annotations

import pytest


def test_each_agent_has_a_certificate(mdm, free, tmp_path):
    pytest.importorskip("cryptography", reason="the extra mdm[certificates]")
    team = free()
    folder = tmp_path / "keys"
    status, output, _ = mdm("team", "certificates", team, "-o", folder, "--days", "3")
    assert (status, output) == (0, [f"{folder}: certificates of an authority and a, b, operator, valid for 3 days"])
    names = {"a.key.pem", "a.pem", "authority.pem", "b.key.pem", "b.pem"}
    assert {path.name for path in folder.iterdir()} >= names
    team.write_text(team.read_text().replace("agents = [", 'agents = ["c", '))
    status, output, _ = mdm("team", "certificates", team, "-o", folder)
    assert (status, output) == (
        0,
        [
            f"{folder}: certificates of an authority and c, valid for 30 days",
            f"{folder}: those of a, b, operator stay as they are",
        ],
    )
    status, _, errors = mdm("team", "certificates", team, "-o", folder)
    assert status == 1
    assert "are there already" in errors


def test_hosts_of_the_team_s_page_are_in_the_certificate_of_its_operator(mdm, free, tmp_path):
    x509 = pytest.importorskip("cryptography.x509", reason="the extra mdm[certificates]")
    assert mdm("team", "certificates", free(), "-o", tmp_path, "--host", "robot.test", "--host", "192.0.2.7")[0] == 0
    for name, hosts in (("operator", ["robot.test", "192.0.2.7"]), ("a", ["127.0.0.1"])):
        made = x509.load_pem_x509_certificate((tmp_path / f"{name}.pem").read_bytes())
        names = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        assert [str(each.value) for each in names] == hosts


def test_a_router_has_a_certificate_of_its_host_and_agents_need_none(mdm, free, tmp_path):
    x509 = pytest.importorskip("cryptography.x509", reason="the extra mdm[certificates]")
    team = free()
    text = team.read_text()
    agents = text[text.index("agents = [") : text.index("]\n", text.index("agents = [")) + 1]
    team.write_text(text.replace(agents, 'agents = ["a", "b"]\nrouter = "tls/r.test:7447"'))
    assert mdm("team", "certificates", team, "-o", tmp_path / "keys")[0] == 0
    for name, hosts in (("router", ["r.test"]), ("a", None)):
        made = x509.load_pem_x509_certificate((tmp_path / "keys" / f"{name}.pem").read_bytes())
        kinds = [one.value for one in made.extensions if one.oid == x509.SubjectAlternativeName.oid]
        assert [[str(each.value) for each in one] for one in kinds] == ([] if hosts is None else [hosts])


def test_days_are_a_number(mdm, free):
    assert mdm("team", "certificates", free(), "--days", "0")[0] == 2
    pytest.importorskip("cryptography", reason="the extra mdm[certificates]")
    status, _, errors = mdm("team", "certificates", free(), "--days", "99999999")
    assert status == 1
    assert errors == "mdm team certificates: certificates are valid for 1 to 36500 days, not for 99999999\n"


def test_a_file_is_no_folder(mdm, free):
    pytest.importorskip("cryptography", reason="the extra mdm[certificates]")
    team = free()
    status, _, errors = mdm("team", "certificates", team, "-o", team)
    assert (status, errors) == (1, f"mdm team certificates: cannot write to {team}: that is no folder\n")
