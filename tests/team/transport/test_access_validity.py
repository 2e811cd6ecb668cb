"""For how long certificates are valid, and who is told of their end."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from mdm.team.transport import access as validity
from mdm.team.transport.access import Validity, days_left, ending, valid_until
from mdm.team.transport.certificates import make_certificates
from mdm.testing import run_virtual

pytest.importorskip("cryptography", reason="makes the certificates")


@pytest.fixture
def files(tmp_path):
    return lambda days: make_certificates(tmp_path, {"ada": []}, days=days)["ada"]


def day_by_day(access, monkeypatch, *, listens=True, days=3.0, change=None):
    """Run for some days; return the faults, with how many days were left when each came."""

    async def main(runtime):
        told = []
        began, start = valid_until(access) - 3 * 86400, runtime.now()
        monkeypatch.setattr(
            validity, "time", SimpleNamespace(time=lambda: began + (runtime.now() - start) / 1e9)
        )  # which goes on as the test's does
        runtime.faults.subscribe(lambda fault: told.append((actor.days, fault)))
        actor = Validity(access, "ada", listens=listens)
        await runtime.start(actor)
        await asyncio.sleep((days - 0.1) * 86400)
        if change is not None:
            change()
            told.clear()
            await asyncio.sleep(86400)
        return told, actor.days

    return run_virtual(main)


def test_the_last_two_days_are_told_by_faults_and_not_those_before(files, monkeypatch):
    told, left = day_by_day(files(3), monkeypatch)
    assert 0 < left < 0.2
    assert {fault.kind for _, fault in told} == {"certificate"}
    assert 1.7 < told[0][0] < 2.0
    assert told[0][1].detail == (
        f"the certificate of 'ada', or of the authority that signed it, ends in {told[0][0]:.1f} days: renew the "
        "files, for then nobody reconnects; this agent takes them up when it is started again"
    )


@pytest.mark.parametrize("days", [3, 40])
def test_days_are_those_of_certificates_that_lie_here(files, tmp_path, days):
    access = files(days)
    assert days_left(access) == pytest.approx(days, abs=0.01)
    (tmp_path / "ada.pem").unlink()
    assert (days_left(access), days_left(None)) == (None, None)


def test_one_that_has_ended_is_told_so():
    assert ending(-0.1, "ada") == "the certificate of 'ada', or of the authority that signed it, has ended"


@pytest.mark.parametrize("listens", [True, False])
def test_renewed_files_count_for_who_connects_alone(files, monkeypatch, tmp_path, listens):
    access = files(3)

    def renew():
        for name in ("ada.pem", "ada.key.pem"):
            (tmp_path / name).unlink()
        files(90)

    told, left = day_by_day(access, monkeypatch, listens=listens, change=renew)
    assert (left < 0, bool(told)) == (listens, listens)


def test_files_that_are_gone_count_as_before(files, monkeypatch, tmp_path):
    told, left = day_by_day(files(3), monkeypatch, listens=False, change=(tmp_path / "ada.pem").unlink)
    assert told[-1][1].detail.endswith("takes them up when it connects to its router again")
    assert -1 < left < 0
