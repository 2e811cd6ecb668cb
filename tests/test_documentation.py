"""What the pages show works: the README's program, the configuration page's file."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import tomllib

import blocks
import numpy as np
import pytest
from places import ROOT

from mdm import ModelError, Runtime, problems, run, save_model
from mdm.cli import main
from mdm.cli.projects.completion import commands
from mdm.models import MDP, POMDP, Factor, Space
from mdm.team import Network


def read(page):
    return (ROOT / page).read_text(encoding="utf-8")


def test_the_readme_s_program_is_the_example():
    program = blocks.texts("README.md", "python")[0]
    example = (ROOT / "examples" / "first.py").read_text(encoding="utf-8")
    assert example.endswith(program)


def test_the_page_on_installing_names_every_extra():
    extras = tomllib.loads(read("pyproject.toml"))["project"]["optional-dependencies"].keys() - {"dev", "demo", "docs"}
    assert set(re.findall(r"^pip install '\.\[(\w+)\]'", read("docs/install.md"), re.MULTILINE)) == extras


def test_the_configuration_page_s_file_is_complete(tmp_path, monkeypatch, capsys):
    whole = blocks.texts("docs/configuration.md", "toml", "\n## A file with most of it\n")[0]
    (tmp_path / "robot.toml").write_text(whole)
    (tmp_path / "robot.py").write_text(
        "async def read_sensors(system): pass\nasync def assist(): pass\ndef stop(): pass\ndef go_on(): pass\n"
        "def cut_motors(): pass\n"
    )
    (tmp_path / "top.policy").write_text("[4](0,1,2,0)")
    states = Space([Factor("waiting", ["no", "yes"]), Factor("place", ["north", "south"])])
    model = MDP([np.eye(4)] * 3, np.zeros((4, 3)), discount=0.9, states=states, actions=["Patrol", "Assist", "Stop"])
    save_model(model, tmp_path / "top.pomdpx")
    (tmp_path / "patrol.pomdp").write_text(
        "discount: 0.9\nvalues: reward\nstates: 1\nactions: GoOn\nobservations: seen lost\n"
        "T: * identity\nO: * uniform\n"
    )
    (tmp_path / "patrol.vf").write_text("0 -1\n0\n")
    monkeypatch.setitem(sys.modules, "robot", None)
    del sys.modules["robot"]  # that of this folder is imported, and forgotten with the patch
    monkeypatch.setattr(sys, "path", list(sys.path))
    status = main(["check", str(tmp_path / "robot.toml")])
    assert (status, capsys.readouterr().err) == (0, "")


def test_the_tables_of_pages_are_right_but_for_what_is_not_there(tmp_path, capsys):
    """They name functions, models and maps of a robot that there is none of."""
    absent = "there is no module 'robot'|there is no such file|the required key '(policy|graph)' is missing"
    pages = ("docs/configuration.md", "docs/maps.md", "docs/moving.md", "docs/teams.md")
    tables = [text for page in pages for text in blocks.texts(page, "toml") if "[ensembles" in text]
    assert len(tables) >= 6
    for number, text in enumerate(tables):
        path = tmp_path / f"{number}.toml"
        path.write_text(text)
        main(["check", str(path)])
        found = [line for line in capsys.readouterr().err.splitlines() if not line.endswith("problems found")]
        assert [line for line in found if not re.search(absent, line)] == []


def test_the_commands_of_their_page_have_these_options():
    """Beside those in a block that runs: of each line the verb, and all that begins with dashes."""
    parsers = {command.words: command for command in commands()}
    pages = ("README.md", "docs/command.md", "docs/speed.md")
    lines = [line for page in pages for text in blocks.texts(page, "console") for line in text.splitlines()]
    lines = [line.partition("#")[0].split() for line in lines if line.startswith("mdm ")]
    assert len(lines) > 20
    for words in lines:
        known = next(parsers[name] for name in (" ".join(words[:3]), " ".join(words[:2])) if name in parsers)
        options = {option for names, *_ in known.options for option in names}
        if known.words != "mdm problem":
            given = {word.strip("[]") for part in words for word in part.split("|") if word.strip("[").startswith("-")}
            assert given <= options, words


def test_the_errors_of_the_page_about_models_are_the_real_ones():
    stay, names = np.eye(2), {"discount": 0.9, "states": ["home", "work"], "actions": ["stay", "push"]}
    messages = re.findall(r"^\| `(.*?)` \|", read("docs/models.md"), re.MULTILINE)
    wrong = (
        lambda: MDP(
            [stay, stay * 1.1], np.zeros((2, 2)), discount=0.9, states=["home", "work"], actions=["stay", "go"]
        ),
        lambda: MDP([stay, stay], np.zeros((2, 3)), discount=0.9),
        lambda: MDP([stay, stay], np.zeros((2, 2)), **names).transition("puhs", "home"),
        lambda: POMDP([stay], [stay], np.zeros((2, 1)), discount=0.9, observation_names=["a", "b", "c"]),
        lambda: POMDP([stay], stay, np.zeros((2, 1)), discount=0.9),
    )
    for make, message in zip(wrong, messages, strict=True):
        with pytest.raises(ModelError, match=re.escape(message)):
            make()


def test_the_programs_of_the_page_about_communicating_teams_run():
    scope: dict[str, object] = {}
    for block in blocks.texts("docs/communicating.md", "python"):
        exec(block.replace("episodes=1000", "episodes=10"), scope)
    assert scope["history"] is None or scope["history"].agent == 0
    assert scope["result"].episodes == 10


def test_every_key_of_an_ensemble_is_in_the_page():
    from mdm.config.tables import ActionTable, EnsembleTable

    page = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    for table in (EnsembleTable, ActionTable):
        for key in table.__struct_fields__:
            assert f"`{key}`" in page, key


def test_every_verb_is_in_the_page_on_the_command():
    from mdm.cli import VERBS

    page = read("docs/command.md")
    for verb in VERBS:
        assert f"mdm {verb} " in page


@pytest.mark.parametrize(("page", "most"), [("README.md", 700), ("docs/teams.md", 4_500), ("docs/safety.md", 2_500)])
def test_a_page_has_at_most_so_many_words_outside_code(page, most):
    text = re.sub(r"^```.*?^```$|<!--.*?-->", "", read(page), flags=re.MULTILINE | re.DOTALL)
    assert sum(re.search(r"\w", word) is not None for word in text.split()) <= most


def test_every_page_is_in_the_index():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").split()
    assert [page.stem for page in (ROOT / "docs").glob("*.md") if page.stem not in {"index", *index}] == []


def test_every_format_is_in_its_page():
    from mdm.formats.files import MODEL_SUFFIXES

    page = read("docs/formats.md")
    for suffix in MODEL_SUFFIXES:
        assert f"`{suffix}`" in page, suffix


PROBLEMS = re.findall(r"^\| `((\w+)\(.*\))` \| (\d+) \| (\d+) \| (\d*) ?\|", read("docs/problems.md"), re.MULTILINE)


@pytest.mark.parametrize(("call", "states", "actions", "observations"), [(row[0], *row[2:]) for row in PROBLEMS])
def test_the_sizes_of_the_problems_are_as_the_page_says(call, states, actions, observations):
    name, numbers = call.rstrip(")").split("(")
    model = getattr(problems, name)(*(int(number) for number in numbers.split(",") if number))
    assert (len(model.state_space), len(model.action_space)) == (int(states), int(actions))
    assert model.kind == ("POMDP" if observations else "MDP")
    if observations:
        assert len(model.observation_space) == int(observations)


def test_every_problem_is_in_the_page():
    assert set(problems.__all__) == {row[1] for row in PROBLEMS}


def test_the_values_in_the_page_are_those_of_the_docstrings():
    for line in read("docs/problems.md").splitlines():
        if line.startswith("| `"):
            name = line.removeprefix("| `").partition("(")[0]
            value = line.split("|")[5].strip().partition(" ")[0]
            assert value in getattr(problems, name).__doc__, name


def test_the_programs_of_the_page_about_replicated_and_centralised_teams_run():
    scope: dict[str, object] = {"stand_still": print, "open_left": print, "open_right": print}
    for block in blocks.texts("docs/teams.md", "python", "\n## Replicated\n", "\n## Communicating\n"):
        program = block.replace('mdm.run(robot("left"))', 'member = robot("left")')
        exec(program.replace("mdm.run(agent(sys.argv[1]))", ""), scope)
    assert scope["member"].agent == "left"


def test_the_program_of_the_page_about_placement_decides_off_board(capsys):
    program = blocks.texts("docs/teams.md", "python", "\n### Placement\n")[0]
    scope: dict[str, object] = {}
    exec(program.replace("mdm.run(agent(sys.argv[1]))", ""), scope)

    async def main():
        async with Runtime(log=None) as runtime:
            network = Network(runtime.clock, team="rover")
            for name in ("robot", "base"):
                await runtime.start(scope["agent"](name, transport=network.transport(name)))
            await asyncio.sleep(30)

    run(main, virtual=True)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 40
    assert all(line.startswith("robot ") for line in lines)
    assert {"hears", "opens"} == {line.split()[1] for line in lines}


def test_the_program_of_the_page_about_testing_teams_runs():
    program = blocks.texts("docs/teams.md", "python", "\n## Testing a team\n")[0]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=100
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_glossary_has_each_word_once_in_order():
    words = re.findall(r"^\*\*(.+?)\*\*: ", read("docs/glossary.md"), re.MULTILINE)
    assert words == sorted(set(words), key=str.lower)
    assert {"acknowledge", "commit", "gate", "leader", "life", "mode", "pending", "quorum", "source", "term"} <= set(
        words
    )
