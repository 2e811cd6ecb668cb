"""A wheel has the package and the examples, whole, for every machine."""

from __future__ import annotations

import subprocess
import sys
import zipfile

import pytest
from places import ROOT

pytest.importorskip("hatchling")

if not (ROOT / "mdm").is_dir():
    pytest.skip("there is nothing to build beside these tests", allow_module_level=True)


def test_a_wheel_is_for_every_machine(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        found = {name for name in archive.namelist() if name.startswith("mdm")}
    code = {path.relative_to(ROOT).as_posix() for path in ROOT.glob("mdm/**/*.py")} | {"mdm/py.typed"}
    page = [path for path in (ROOT / "mdm" / "views" / "web" / "static").rglob("*") if path.is_file()]
    code |= {path.relative_to(ROOT).as_posix() for path in page}
    examples = {
        f"mdm/{path.relative_to(ROOT).as_posix()}"
        for path in ROOT.glob("examples/**/*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert found == code | examples
