"""The public names: listed, importable, documented."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from places import ROOT
from sentences import refused

import mdm
import mdm.actors
import mdm.beliefs
import mdm.config
import mdm.explanation
import mdm.formats
import mdm.gym
import mdm.logic
import mdm.maps
import mdm.messages
import mdm.models
import mdm.policies
import mdm.runtime
import mdm.simulation
import mdm.solvers
import mdm.team
import mdm.testing

PACKAGES = [mdm, mdm.actors, mdm.beliefs, mdm.config, mdm.formats, mdm.logic, mdm.messages, mdm.models, mdm.policies]
PACKAGES += [mdm.explanation, mdm.gym, mdm.maps, mdm.runtime, mdm.simulation, mdm.solvers, mdm.team, mdm.testing]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_every_listed_name_is_there_and_documented(package):
    for name in package.__all__:
        thing = getattr(package, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert thing.__doc__, f"{package.__name__}.{name} has no docstring"


def test_every_public_name_of_the_packages_is_listed():
    for package in PACKAGES:
        public = {
            name
            for name, thing in vars(package).items()
            if not name.startswith("_") and getattr(thing, "__module__", "").startswith(f"{package.__name__}.")
        }
        assert public <= set(package.__all__), package.__name__


def test_a_name_of_a_package_is_pointed_out():
    with refused(AttributeError):
        _ = mdm.QTable
    with refused(AttributeError):
        _ = mdm.Nonsense


def test_importing_loads_nothing_else():
    """What a program does not ask for costs it nothing."""
    program = "import sys, mdm; print(*(m for m in sys.modules if m.startswith(('mdm.', 'numpy', 'numba', 'scipy'))))"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "\n"


def test_little_is_loaded_before_the_command_heeds_ctrl_c():
    """Before it does, Ctrl-C shows a traceback; -S leaves out what an installation loads for itself."""
    program = f"import sys; sys.path.insert(0, {str(Path(mdm.__file__).parents[1])!r}); import mdm.__main__; "
    program += "print(*sorted(name for name in ('typing', 're', 'argparse', 'mdm.cli') if name in sys.modules))"
    done = subprocess.run([sys.executable, "-S", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def test_a_running_robot_loads_no_solver_format_or_compiler():
    """What an ensemble with a table takes; scipy and numba, too, come with those who need them."""
    program = """
import sys
import tomllib
import mdm
robot = mdm.Ensemble("robot", policy=[0, 1], actions={"a": print, "b": print})
async def main():
    async with mdm.Runtime(log=None) as runtime:
        await runtime.start(robot)
        robot.publish_state(1)
mdm.run(main)
unwanted = ("mdm.solvers", "mdm.formats", "mdm.simulation", "mdm.cli", "mdm.views", "numba", "scipy")
print(sorted(name for name in sys.modules if name.startswith(unwanted)))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


def test_a_file_without_a_team_or_a_map_loads_nothing_of_them():
    program = """
import sys
import tomllib
import mdm
mdm.load_system("examples/tiger.toml")
print(sorted(name for name in sys.modules if name.startswith(("mdm.team", "zenoh", "mdm.maps"))))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


def test_a_verb_loads_no_other_and_a_file_no_other_format():
    program = """
import sys
import tomllib
from mdm.cli import main
assert main(["run", "examples/tiger.toml", "--virtual", "--epochs", "1"]) == 0
formats = ("openmarkov", "sarsop", "zmdp", "mdm1", "cassandra.policy_graph", "madp.dpomdp", "madp.joint_policy")
others = tuple(f"mdm.formats.{name}" for name in formats)
verbs = ("mdm.cli.files", "mdm.cli.map", "mdm.cli.policies", "mdm.cli.team", "mdm.cli.robots.trace")
print(sorted(name for name in sys.modules if name.startswith((*others, *verbs))))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


def test_the_names_of_teams_load_what_they_need():
    program = """
import sys
import tomllib
import mdm.team
before = set(sys.modules)
from mdm.team import Team
print(sorted(name for name in before if name.startswith("mdm.")))
print(sorted(name for name in sys.modules if name.startswith(("mdm.team.agreement", "mdm.team.member", "zenoh"))))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["['mdm.team']", "[]"]


def test_maps_load_no_actors_and_no_pictures():
    program = """
import sys
import tomllib
import mdm.maps
print(sorted(name for name in sys.modules if name.startswith(("mdm.actors", "mdm.runtime", "PIL", "yaml"))))
mdm.maps.Places
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_what_maps_have_not_is_refused():
    with refused(AttributeError):
        _ = mdm.maps.Nonsense
    assert dir(mdm.maps) == mdm.maps.__all__


def test_what_teams_have_not_is_refused():
    with refused(AttributeError):
        _ = mdm.team.Nonsense
    assert dir(mdm.team) == mdm.team.__all__


def test_a_misspelt_name_gets_a_suggestion():
    with refused(AttributeError):
        _ = mdm.POMPD
    with refused(AttributeError):
        _ = mdm.Ensembel


@pytest.mark.parametrize("name", ["actors", "config", "formats", "logic", "messages", "runtime"])
def test_a_package_is_there_without_an_import_of_its_own(name):
    program = f"import mdm; print(mdm.{name}.__name__)"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == (
        f"mdm.{name}\n"
    )


def test_the_version_is_that_of_the_installation():
    from importlib.metadata import version

    assert mdm.__version__ == version("markov-decision-making")


def test_hints_at_installing_name_packages_of_the_extras_alone():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    packages = {re.split(r"[>=;\[ ]", each)[0] for given in extras.values() for each in given}
    hinted = {
        name
        for path in (ROOT / "mdm").rglob("*.py")
        for words in re.findall(r"pip install ([a-z][\w\- ]*)", path.read_text())
        for name in words.split()
    }
    assert hinted
    assert hinted <= packages, hinted - packages


def test_the_extra_all_has_each_other_one_that_a_user_may_want():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    (named,) = re.findall(r"\[(.*)\]", extras["all"][0])
    assert set(named.split(",")) == extras.keys() - {"all", "demo", "dev", "docs"}
