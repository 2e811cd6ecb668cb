"""A new folder is there as a whole, or not at all."""

from __future__ import annotations

import pytest

from mdm.cli.projects.examples import making


def test_an_empty_folder_is_filled(tmp_path):
    target = tmp_path / "made"
    target.mkdir()
    with making(target) as made:
        (made / "file").write_text("content")
        assert list(target.iterdir()) == []
    assert (target / "file").read_text() == "content"
    assert list(tmp_path.iterdir()) == [target]


def test_what_fails_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), making(tmp_path / "made") as made:
        (made / "file").write_text("content")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
