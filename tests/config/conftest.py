"""Folders of configuration files, with the code and the policies they name."""

from __future__ import annotations

import pytest
from robot_file import CALLBACKS


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot_code.py").write_text(CALLBACKS)
    (tmp_path / "broken_code.py").write_text("1 / 0\n")
    (tmp_path / "leaving_code.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "below.policy").write_text("[2](1,0)")
    (tmp_path / "cut.policy").write_text("[2](0,")
    (tmp_path / "three.policy").write_text("[3](0,1,1)")
    return tmp_path
