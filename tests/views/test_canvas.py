"""Where pictures go, and that they need matplotlib."""

from __future__ import annotations

import sys

import pytest
from sentences import refused

from mdm import Error, FormatError
from mdm.views.canvas import check_picture, keep, pyplot

BEGINNINGS = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


@pytest.mark.parametrize("suffix", BEGINNINGS)
def test_a_suffix_says_of_which_kind_a_picture_is_and_figures_are_closed(tmp_path, suffix):
    pytest.importorskip("matplotlib")
    plt = pyplot()
    before = plt.get_fignums()
    figure, _ = plt.subplots()
    path = tmp_path / f"a.{suffix.upper()}"
    check_picture(str(path))
    keep(figure, str(path))
    assert path.read_bytes().startswith(BEGINNINGS[suffix])
    figure, _ = plt.subplots()
    with refused(FormatError):
        keep(figure, str(tmp_path / "none" / "a.png"))
    assert plt.get_fignums() == before


def test_a_place_is_refused_before_there_is_something_to_draw(tmp_path):
    (tmp_path / "read.png").write_bytes(b"")
    with refused(Error):
        check_picture(str(tmp_path / "a.txt"))
    with refused(Error):
        check_picture(str(tmp_path / "none" / "a.png"))
    with refused(Error):
        check_picture(str(tmp_path / "read.png"), str(tmp_path / "read.png"))


def test_without_matplotlib_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with refused(Error):
        pyplot()
