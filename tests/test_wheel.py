"""Wheels are built as the environment says, and without a compiler as plain Python."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from places import ROOT

pytest.importorskip("hatchling")

if not (ROOT / "mdm").is_dir():
    pytest.skip("there is nothing to build beside these tests", allow_module_level=True)


def build(folder, **environment):
    """Return the wheel that is built, and what was printed."""
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT,
        env={**os.environ, "MDM_WHEEL": "", **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = folder.glob("*.whl")
    return wheel, done.stdout + done.stderr


def files_of(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if name.startswith("mdm")}


def sources():
    return {path.relative_to(ROOT).as_posix() for path in ROOT.glob("mdm/**/*.py")} | {"mdm/py.typed"}


def test_a_plain_wheel_is_for_every_machine(tmp_path):
    wheel, printed = build(tmp_path, MDM_WHEEL="plain")
    assert wheel.name.endswith("-py3-none-any.whl")
    assert files_of(wheel) == sources()
    assert printed.count("plain Python") == 1
    assert "MDM_WHEEL is 'plain'" in printed


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="plain on this version of Python, whatever there is")
def test_without_a_compiler_a_wheel_is_plain_and_one_line_says_why(tmp_path):
    pytest.importorskip("setuptools")
    wheel, printed = build(tmp_path, CC="/bin/false")
    assert wheel.name.endswith("-py3-none-any.whl")
    assert files_of(wheel) == sources()
    (line,) = [line for line in printed.splitlines() if "plain Python" in line]
    assert "/bin/false" in line


def test_what_is_to_be_compiled_fails_where_it_cannot_be(tmp_path):
    with pytest.raises(AssertionError, match="mdm could not be compiled"):
        build(tmp_path, CC="/bin/false", MDM_WHEEL="compiled")


def test_another_wish_is_refused(tmp_path):
    with pytest.raises(AssertionError, match="MDM_WHEEL is 'plain' or 'compiled', not 'fast'"):
        build(tmp_path, MDM_WHEEL="fast")


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="plain on this version of Python, whatever there is")
def test_types_hold_where_no_more_is_installed_than_what_compiles(tmp_path):
    """A wheel is built in an environment of its own, without numpy: there its types are unknown."""
    pytest.importorskip("mypy")
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    (tmp_path / "msgspec").symlink_to(Path(importlib.util.find_spec("msgspec").origin).parent)
    told = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    modules = told["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["custom"]["modules"]
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "mypy",
            *hook.OPTIONS,
            "--no-site-packages",
            f"--cache-dir={tmp_path / 'cache'}",
            *modules,
        ],
        cwd=ROOT,
        env={**os.environ, "MYPYPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stdout
