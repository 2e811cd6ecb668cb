"""`mdm check robot.py:make`: what a function returns, checked as a file is."""

from __future__ import annotations

import pytest

PROGRAM = """
import mdm


def make(latest=None, names=("A", "B"), drive="event", formula="A and C"):
    predicates = mdm.PredicateManager()
    for name in ("A", "B", "C"):
        predicates.sensor(name)
    predicates.define("D", formula)
    return mdm.Ensemble(
        "robot",
        policy=[0, 1],
        drive=drive,
        predicates=predicates,
        states=[mdm.StateFactor("s", list(names))],
        actions={"Go": print, "Stop": print},
    )


def idle():
    return make(formula="A and B")


def fast():
    return make(drive=2000.0)


def several():
    return [make(names=("D", "A"))]


def system():
    robot = make()
    return mdm.System(robot.predicates, {"robot": robot}, [])


def undeclared():
    return make(names=("A", "Bee"))


def needy(one):
    return make()


def failing():
    raise ValueError("no battery")


def leaving():
    raise SystemExit(3)


def nothing():
    return None


async def later():
    return make()


number = 3
"""


@pytest.fixture
def path(tmp_path, request):
    path = tmp_path / f"robot_{request.node.name.translate({ord(each): '_' for each in '[]-. :'})}.py"
    path.write_text(PROGRAM, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("function", "note"),
    [
        ("make", None),
        ("idle", "nothing in this file uses 'C'"),
        ("fast", "ensembles.robot.drive = 2000 are decisions a second"),
        ("several", "ensemble 'robot': 'D' and 'A' of the state factor 's' are both true where A and C are"),
        ("system", None),
    ],
)
def test_what_a_function_returns_has_the_notes_of_a_file(mdm, path, function, note):
    status, output, errors = mdm("check", f"{path}:{function}")
    assert (status, errors) == (0, "")
    assert output[-1] == f"{path}:{function}: ensembles, no problems found"
    assert note is None or any(f"{path}:{function}: note: {note}" in line for line in output)


@pytest.mark.parametrize(
    ("function", "told"),
    [
        ("undeclared", "Bee"),
        ("needy", "'needy', called without arguments, has raised TypeError: needy() missing 1 required"),
        ("failing", "'failing', called without arguments, has raised ValueError: no battery"),
        ("leaving", "'leaving', called without arguments, has raised SystemExit: 3"),
        ("nothing", "it returns NoneType, not an Ensemble, several of them or a System"),
        ("later", "'later' is an async function, not a plain function"),
        ("number", "is a int, not a function"),
        ("mak", "has no 'mak'; did you mean 'make'?"),
    ],
)
def test_what_is_wrong_is_a_sentence(mdm, path, function, told):
    status, _, errors = mdm("check", f"{path}:{function}")
    assert status == 1
    assert errors.startswith(f"mdm check: {path}:{function}: ")
    assert told in errors
    assert "Traceback" not in errors


def test_files_without_a_function_and_files_that_are_not_there(mdm, path, tmp_path):
    assert "name a function in it" in mdm("check", path)[2]
    assert "there is no file" in mdm("check", f"{tmp_path / 'none.py'}:make")[2]
    assert mdm("check", f"{path}:make", "--import")[0] == 2
