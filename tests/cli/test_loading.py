"""Which modules a verb loads: no more than what it does needs."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from places import ROOT

import mdm
from mdm.cli import VERBS

PROGRAM = """
import contextlib, io, json, sys
from mdm.cli import main
with contextlib.redirect_stdout(io.StringIO()):
    try:
        main(sys.argv[1:])
    except SystemExit:
        pass
print(json.dumps(sorted(sys.modules)))
"""


def loaded(*arguments):
    """Return the modules that a command has loaded at its end."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return json.loads(done.stdout)


def of(package, modules):
    return [name for name in modules if name == package or name.startswith(f"{package}.")]


@pytest.fixture(scope="module")
def tiger(tmp_path_factory):
    path = tmp_path_factory.mktemp("loading") / "tiger.pomdp"
    mdm.save_model(mdm.problems.tiger(), path)
    return path


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["solve", "--help"], ["map", "goals", "--help"]])
def test_help_loads_what_the_verbs_take_alone(arguments):
    modules = loaded(*arguments)
    assert len(of("mdm", modules)) <= 10
    assert not of("numpy", modules)


def test_what_all_verbs_take_is_known_without_numpy():
    folders = sorted({folder for folder, _ in VERBS.values()})
    program = f"import sys, mdm.cli\nfor f in {folders}: __import__('mdm.cli.' + f)\nprint('numpy' in sys.modules)"
    assert (
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "False\n"
    )


def test_a_solver_loads_no_actors(tiger):
    solving = loaded("solve", tiger, "--gap", "1")
    assert len(of("mdm", solving)) <= 110
    assert of("mdm.solvers", solving)
    for package in ("mdm.actors", "mdm.runtime", "mdm.config", "mdm.team", "mdm.maps", "mdm.views"):
        assert not of(package, solving)


def test_a_robot_loads_no_solvers():
    running = loaded("run", "--virtual", "--epochs", "2", "examples/patrol/patrol.toml")
    assert of("mdm.actors", running)
    for package in ("mdm.solvers", "mdm.views", "mdm.ros2"):
        assert not of(package, running)


def test_a_robot_is_checked_without_ros():
    assert not of("mdm.ros2", loaded("check", "examples/patrol/patrol.toml"))


@pytest.mark.parametrize("verb", ["info", "check"])
def test_a_model_is_looked_at_without_actors(tiger, verb):
    modules = loaded(verb, tiger)
    assert of("mdm.formats", modules)
    assert not of("mdm.actors", modules)


def test_a_robot_is_checked_without_what_checks_teams():
    modules = loaded("check", "examples/tiger.toml")
    assert of("mdm.config", modules)
    assert not of("mdm.cli.team", modules)
    assert not of("mdm.team", modules)
