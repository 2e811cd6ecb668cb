"""``mdm examples``: every example is listed, and runs where it was copied."""

from __future__ import annotations

import in_process
import pytest
from places import EXAMPLES as FOLDER

from mdm.cli import main
from mdm.cli.projects.examples import EXAMPLES


def files():
    """Return all files of the folder of examples, but for what Python keeps."""
    return {
        path.relative_to(FOLDER)
        for path in FOLDER.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and "projects" not in path.parts  # those of mdm new
    }


def test_every_file_is_part_of_an_example():
    parts = {FOLDER / path for example in EXAMPLES.values() for path in example.paths}
    assert [path for path in files() if not {FOLDER / path, *(FOLDER / path).parents} & parts] == []
    assert [path for path in parts if not path.exists()] == []


def test_they_are_listed(capsys):
    assert main(["examples"]) == 0
    told = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in told] == list(EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_all_files_that_it_needs_are_copied(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["examples", name]) == 0
    command = capsys.readouterr().out.splitlines()[1].removeprefix("Run it there: ").split()
    copied = tmp_path / name
    assert next(copied.rglob("__pycache__"), None) is None
    for path in copied.rglob("*.toml"):
        verb = ["team", "check"] if "[team]" in path.read_text() else ["check"]
        assert main([*verb, str(path)]) == 0, capsys.readouterr()
    if name in {"first", "tiger", "from_arrays", "rooms", "external_belief"}:
        done = in_process.script(copied / command[1], *command[2:], folder=copied)
        assert (done.status, done.wrong) == (0, "")
    else:
        assert any((copied / word).is_file() for word in command)


@pytest.mark.parametrize(
    ("arguments", "status", "told"),
    [
        (["patrl"], 2, "there is no example 'patrl'; did you mean patrol?"),
        (["xyz"], 2, "there is no example 'xyz'; `mdm examples` lists them"),
        (["-o", "x"], 2, "-o goes with the name of an example"),
        (["tiger", "-o", "full"], 1, "full: this folder is not empty"),
    ],
)
def test_wrong_input(tmp_path, monkeypatch, capsys, arguments, status, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    assert main(["examples", *arguments]) == status
    assert told in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["full", "mine"]


def test_where_the_examples_are_not_it_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("mdm.__file__", str(tmp_path / "mdm" / "__init__.py"))
    monkeypatch.chdir(tmp_path)
    assert main(["examples", "tiger"]) == 1
    assert "the examples are not beside the package" in capsys.readouterr().err
