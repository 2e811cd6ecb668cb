"""Where a page listens and what it shows there, by the options of the verbs and the file of a team."""

from __future__ import annotations

from argparse import Namespace

import pytest
from team_file import write

from mdm.cli.robots.run import page_hosts, refuse_without_page
from mdm.cli.usage import UsageError, certificate


def asked(file, host=None, access=None):
    return Namespace(file=str(file), page_host=host, page_access=access)


def test_beyond_loopback_a_page_shows_the_certificate_that_its_team_has_for_it(tmp_path):
    team = write(tmp_path, ('name = "rooms"', 'name = "rooms"\naccess = "keys"'))
    shown = page_hosts(asked(team, "robot.test"), "a")
    assert shown["host"] == "robot.test"
    assert shown["access"].certificate == str(tmp_path / "keys" / "a.pem")
    assert shown["access"].authority == str(tmp_path / "keys" / "authority.pem")
    for host in (None, "127.0.0.1", "localhost", "::1"):
        assert page_hosts(asked(team, host), "a") == {"host": host or "127.0.0.1", "access": None}
    given = certificate(str(tmp_path / "other" / "robot"))
    assert page_hosts(asked(team, "robot.test", given), "a")["access"] is given
    assert page_hosts(asked(team, None, given), "a") == {"host": "127.0.0.1", "access": given}
    assert page_hosts(asked(write(tmp_path), "robot.test"), "a")["access"] is None
    assert page_hosts(asked(tmp_path / "robot.toml", "robot.test"), None)["access"] is None


def test_a_certificate_is_named_without_its_suffix():
    access = certificate("keys/robot.one")
    assert (access.certificate, access.key) == ("keys/robot.one.pem", "keys/robot.one.key.pem")


@pytest.mark.parametrize("option", ["page_control", "page_host", "page_access"])
def test_without_a_page_its_options_are_refused(option):
    given = {"page_control": False, "page_host": None, "page_access": None}
    refuse_without_page(Namespace(**given))
    with pytest.raises(UsageError, match=f"--{option.replace('_', '-')} is for a page"):
        refuse_without_page(Namespace(**given | {option: ""}))
