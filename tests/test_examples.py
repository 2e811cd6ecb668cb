"""Every example runs, and does what it says."""

from __future__ import annotations

import asyncio
import io
import itertools
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import zipfile
from bisect import bisect
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from unittest.mock import patch

import blocks
import days
import numpy as np
import pytest
from in_process import script
from PIL import Image
from places import EXAMPLES, ROOT
from team_file import running
from team_processes import histories, on_free_ports, up

import mdm
from mdm.recording import Record
from mdm.team import Committed

PATROL = EXAMPLES / "patrol" / "patrol.py"


def run(name, *arguments):
    done = script(EXAMPLES / name, *arguments)
    assert (done.status, done.wrong) == (0, "")
    return done.output


@contextmanager
def modules(*names):
    """Import modules of examples anew, and forget them."""
    before = list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = before
        for name in names:
            sys.modules.pop(name, None)


def test_embedding():
    lines = run("embedding.py").splitlines()
    assert lines[:4] == ["waiting", "fan on", "fan off", "waiting"]
    assert lines[-1] == "the program went on meanwhile: True"


STEPS = [
    pytest.param(each.info["of"], each.text, marks=[pytest.mark.slow] if "statistics" in each.info["of"] else [])
    for each in blocks.blocks("docs/tutorial.md")
    if each.language == "text"
]
"""That of statistics solves a model, runs for ten minutes, and solves again."""


@pytest.mark.parametrize(("step", "told"), STEPS)
def test_the_steps_of_the_tutorial_print_what_its_page_says(step, told):
    pytest.importorskip("navground")
    assert run(f"tutorial/{step}") == told


def burning(record):
    """Return for how many seconds of a record the demo knew of fires."""
    told = [each.message for each in record.messages(["decisions"]) if each.message.ensemble == "top"]
    ends = [each.time for each in told[1:]] + [record.span[1]]
    fires = [end - each.time for each, end in zip(told, ends, strict=True) if each.state % 2]  # the last factor is it
    return sum(fires) / 1e9


@pytest.mark.slow
def test_what_a_record_of_the_demo_tells_of_its_model_makes_it_better(tmp_path):
    """By the commands of statistics.md; also in the building, of which no model is known."""
    pytest.importorskip("navground")
    folder = tmp_path / "patrol"
    shutil.copytree(EXAMPLES / "patrol", folder)
    checked = [block for block in blocks.blocks("docs/statistics.md") if "checked" in block.info]
    program, run_and_count, told, solve_and_compare = checked
    blocks.run(program, folder, {})
    printed = blocks.printed(run_and_count, folder)
    assert set(told.text.splitlines()) <= {line.rstrip() for line in printed.splitlines()}
    report = blocks.printed(solve_and_compare, folder)
    before = burning(Record(folder / "run.mcap"))
    again = ["run", "patrol.toml", "--virtual", "--seconds", "600", "--record", "after.mcap"]
    (folder / "patrol.toml").write_text((folder / "patrol.toml").read_text().replace("top.policy", "better.policy"))
    subprocess.run([sys.executable, "-m", "mdm", *again], cwd=folder, capture_output=True, timeout=250, check=True)
    after = burning(Record(folder / "after.mcap"))
    assert after < before / 2
    page = (ROOT / "docs" / "statistics.md").read_text()
    assert f"for {after:.0f} of 600 seconds; with the old one it was {before:.0f}." in page
    old, new = (float(line.split()[2]) for line in lines_with(report, "exact value"))
    assert f"The old policy is worth {old:.0f}, the new one {new:.0f}." in page


def test_the_patrol_of_the_tutorial_goes_safe_and_on():
    pytest.importorskip("navground")
    lives = run("tutorial/step4_actions.py")
    assert [line.split()[-1] for line in lines_with(lives, " in ")][:4] == [
        "LRM",
        "SouthCorridor",
        "WestCorridor",
        "ElevatorHallway",
    ]
    modes = [line.split()[2] for line in lines_with(run("tutorial/step7_safety.py"), " s  ")]
    assert modes == ["deciding", "safe", "deciding", "safe"]


PICTURES = ROOT / "docs" / "pictures"
DRAWN = sorted((PICTURES / "tutorial").iterdir())


def test_the_pictures_of_the_tutorial_are_small_and_on_its_page():
    assert [path.stem for path in DRAWN] == [f"step{number}" for number in range(1, 8)]
    page = (ROOT / "docs" / "tutorial.md").read_text()
    for path in DRAWN:
        assert f"(pictures/tutorial/{path.name})" in page
        assert path.stat().st_size < 30_000


@pytest.mark.slow
def test_the_pictures_of_the_tutorial_show_what_its_programs_do(tmp_path):
    """What is text is compared; of images the sizes, for fonts are drawn a little differently elsewhere."""
    pytest.importorskip("navground")
    done = script(PICTURES / "tutorial.py", tmp_path)
    assert (done.status, done.wrong) == (0, "")
    assert [path.name for path in DRAWN] == sorted(path.name for path in tmp_path.iterdir())
    for path in DRAWN:
        drawn = tmp_path / path.name
        if path.suffix == ".svg":
            assert path.read_text() == drawn.read_text()
        else:
            with Image.open(path) as one, Image.open(drawn) as other:
                assert one.size == pytest.approx(other.size, abs=20)


def lines_with(text, part):
    return [line for line in text.splitlines() if part in line]


def test_the_top_level_of_the_demo_guarantees_what_the_page_says():
    model = mdm.load_model(PATROL.parent / "top.pomdpx")
    policy = mdm.load_policy(PATROL.parent / "top.policy", model)
    page = (ROOT / "docs" / "examples.md").read_text()
    rows = re.findall(
        r"^\| `([PES]\(.*\))`(?: `--from \"(.*)\"`)?.* \| (\S+) \| (\S+) and (\S+) \|$", page, re.MULTILINE
    )
    assert len(rows) == 6
    for asked, start, *said in rows:
        its = mdm.verify(model, asked, policy, start=start or None).result
        every = mdm.verify(model, asked, start=start or None)
        found = [its.value, every.least.value, every.greatest.value]
        assert [math.inf if each == "infinite" else float(each) for each in said] == pytest.approx(found, rel=2e-3)


def test_the_shielded_robot_does_not_fall_down_the_stairs(tmp_path):
    """The best policy's numbers by paths: three places beside the stairs, and by each a slip of .1 down them."""
    lines = run("stairs.py", str(tmp_path / "stairs.svg")).splitlines()
    told = [[float(each) for each in re.findall(r"-?\d+\.\d+", line)] for line in lines if "falls" in line]
    chances = [each[:2] for each in told]
    assert chances[1:] == [[0, 1]] * 2
    beside = 0.8 / 0.9  # by each place beside them, where a slip to the wall leaves the robot there: on, else down
    assert chances[0] == pytest.approx([1 - beside**3, beside**3], abs=5e-4)
    assert told[1][2] < told[2][2] < told[0][2]
    drawn = (tmp_path / "stairs.svg").read_text()
    assert drawn == (PICTURES / "stairs.svg").read_text()
    assert "pictures/stairs.svg" in (ROOT / "docs" / "how-to.md").read_text()


def test_tiger():
    lines = run("tiger.py").splitlines()
    assert len(lines) == 20
    assert [line.split()[0] for line in lines] == [f"{index / 2:.1f}" for index in range(20)]
    for line in lines:
        chance = float(line.split()[4].rstrip("%"))
        assert ("listen" in line) == (5 < chance < 95)


def test_from_arrays():
    *seen, value, _, once, twice, _ = run("from_arrays.py").splitlines()
    assert seen == ["the machine is good: produce", "the machine is worn: repair"]
    assert value == "value of the best policy: 13.01"
    worn, said = 0.0, []
    for likelihoods in ((0.9, 0.4), (0.1, 0.6), (0.1, 0.6)):  # fine, faulty, faulty: Bayes' rule
        worn = worn + 0.1 * (1 - worn)
        worn = worn * likelihoods[1] / (worn * likelihoods[1] + (1 - worn) * likelihoods[0])
        said.append(f"{worn:.2f}")
    assert [once, twice] == [
        f"faulty: worn with probability {said[1]}, produce",
        f"faulty: worn with probability {said[2]}, repair",
    ]


def test_tree_search(monkeypatch):
    def counted(model, *, seconds, **options):
        """Return a search that ends by a count: in a tenth of a second a busy machine may come nowhere."""
        assert seconds == 0.1
        return TreeSearch(model, expansions=500, **options)

    TreeSearch = mdm.solvers.TreeSearch  # noqa: N806
    monkeypatch.setattr(mdm.solvers, "TreeSearch", counted)
    *lines, last = run("tree_search.py").splitlines()
    assert len(lines) == 12
    for line in lines:
        chance = float(line.split()[2].rstrip("%:"))
        assert ("listen" in line) == (5 < chance < 95)
    assert last == "the loop went on meanwhile: True"


def test_external_belief():
    output = run("external_belief.py")
    assert "by belief: Right" in output
    assert "docking in cell 3; the charger is in cell 3" in output


def test_rooms():
    lines = run("rooms.py").splitlines()
    reached = [line.split()[-2].rstrip(":") for line in lines if ".reached" in line]
    assert "Lab.at_goal and Lab.reached and IsOnTheWayBack: true" in lines[7]
    assert [line.split()[-2:] for line in lines[1:6]] == [
        ["Right", "running"],
        ["Office:", "true"],
        ["Office.reached:", "true"],
        ["Right", "succeeded"],
        ["Right", "running"],
    ]
    office, lobby, lab = "Office.reached", "Lobby.reached", "IsOnTheWayBack"
    assert reached[:6] == [lobby, office, lab, office, lobby, office]


@pytest.mark.parametrize("arguments", [("--fast",), ("--fast", "--seconds", "20", "--log")])
def test_patrol(arguments):
    output = run("patrol/patrol.py", *arguments)
    assert "Patrol: patrol (MDP, 12 states, 4 actions, event-driven)" in output
    assert "Up: way('Up')\n" in output
    for words in ("the state is 'person': Assistance", "a person calls from", "Patrol preempted", "motors are off"):
        assert words in output
    if len(arguments) == 1:
        for words in (
            "Emergency succeeded",
            "Trespassing succeeded",
            "Assistance succeeded",
            "PersonIsWaiting is true",
        ):
            assert words in output
        assert "collisions: 0" in output


def test_the_patrol_of_a_seed_is_the_same_on_every_interpreter():
    """What it did on CPython 3.11, 3.12 and 3.13, where that was written down."""
    output = run("patrol/patrol.py", "--fast")
    log = output.split("The next 40 seconds:\n\n")[1].split("\nAt the end")[0]
    assert log == (ROOT / "tests" / "data" / "patrol" / "forty_seconds.txt").read_text()


def on_a_terminal(seconds, *arguments, **environment):
    """Run the patrol on a terminal; return what it wrote there."""
    here, there = os.openpty()
    written = []

    def read():
        with suppress(OSError), os.fdopen(here, "rb", buffering=0) as terminal:  # which ends by an error
            while part := terminal.read(65536):
                written.append(part)

    reader = threading.Thread(target=read)
    reader.start()
    with (
        os.fdopen(there, "w", encoding="utf-8") as terminal,
        patch.dict(os.environ, {"TERM": "xterm", **environment}),
    ):
        done = script(PATROL, "--seconds", seconds, *arguments, output=terminal)
    reader.join()
    assert (done.status, done.errors) == (0, "")
    return b"".join(written).decode().replace("\r\n", "\n")


def test_the_patrol_is_told_without_colours_where_they_are_not_wanted():
    written = on_a_terminal(1, NO_COLOR="1")
    assert "\x1b[3" not in written
    assert "\x1b[4" not in written
    assert "\x1b" in written  # to draw in one place
    assert "\x1b" not in on_a_terminal(1, TERM="dumb")


@pytest.mark.parametrize(("argument", "wish"), [("--log", "NO_COLOR"), ("--fast", "TERM")])
def test_the_patrol_that_draws_nothing_writes_plain_lines(argument, wish):
    assert "\x1b" not in on_a_terminal(1, argument, **{wish: "dumb"})


def test_the_patrol_on_a_terminal_without_arrows():
    terminal = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    done = script(PATROL, "--fast", "--seconds", "1", output=terminal)
    assert (done.status, done.errors) == (0, "")
    terminal.flush()
    assert "At the end the robot is in " in terminal.buffer.getvalue().decode("ascii")


def test_the_patrol_on_a_full_disk():
    with Path("/dev/full").open("w", encoding="utf-8") as disk:
        done = script(PATROL, "--fast", "--seconds", "1", output=disk)
    assert (done.status, done.errors) == (1, "patrol.py: [Errno 28] No space left on device\n")


def test_a_film_of_no_kind_that_is_known_is_refused():
    done = script(PATROL, "--fast", "--seconds", "1", "--film", "x.bmp")
    message = "patrol.py: x.bmp: a film ends in .gif, or in .png for a sheet of its pictures\n"
    assert done == (1, "", message)


def test_the_pictures_of_a_film_are_as_large_as_is_asked(tmp_path):
    run("patrol/patrol.py", "--fast", "--seconds", "1", "--pixels", "400", "--film", str(tmp_path / "x.gif"))
    with Image.open(tmp_path / "x.gif") as film:
        assert film.width <= 400  # the floor is wider than high
    done = script(PATROL, "--fast", "--pixels", "99", "--film", "x.gif")
    assert (done.status, done.errors.splitlines()[-1]) == (2, "patrol.py: error: --pixels is a number from 100 on")


def test_the_patrol_without_an_output():
    command = f"{sys.executable} {PATROL} --fast --seconds 1 >&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=100)
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)


def test_the_patrol_whose_reader_has_gone():
    command = f"{sys.executable} {PATROL} --fast; echo $? >&2"
    done = subprocess.run(["sh", "-c", f"({command}) | true"], capture_output=True, text=True, timeout=100)
    assert done.stderr.strip() == "1"


def test_the_patrol_that_writes_lines_and_whose_reader_has_gone():
    here, there = os.pipe()
    os.close(here)
    with os.fdopen(there, "w", encoding="utf-8") as gone:
        done = script(PATROL, "--fast", "--log", output=gone)
    assert (done.status, done.errors) == (1, "")


@pytest.mark.parametrize("module", ["argparse", "numpy", "mdm.views", "navground"])
def test_ctrl_c_ends_the_patrol_while_it_is_loading(module):
    """Also where it comes in the middle of an import."""
    program = f"""
import os, runpy, signal, sys

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.modules.pop({module!r}, None)
sys.meta_path.insert(0, Interrupting())
runpy.run_path({str(PATROL)!r}, run_name="__main__")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


def test_another_seed_is_another_day_and_the_same_one_the_same():
    one, other, again = (run("patrol/patrol.py", "--fast", "--seconds", "30", "--seed", seed) for seed in "454")
    assert one != other
    assert one.splitlines()[:-1] == again.splitlines()[:-1]  # the last line tells the time it took
    for output in (one, other):
        assert "top level: idle for 0.0 s, which is 0.0 % of the time" in output
        assert "collisions: 0" in output


def test_a_patrol_that_nobody_disturbs_is_in_each_room_as_often_as_its_model_says():
    """By the model's own chain, in which one drive of ten does not arrive: that changes no room's share."""
    seen = days.day(1, 160, calm=True)
    assert (seen.idle, seen.contacts, seen.failed, seen.longest) == (0.0, 0, 0, 0.0)
    assert not any(leg.disturbed for leg in seen.legs)
    model, policy = mdm.load_model(days.FOLDER / "patrol.npz"), mdm.load_policy(days.FOLDER / "patrol.policy")
    chain = np.array([model.transition_matrix(action)[state] for state, action in enumerate(policy.actions)])
    values, vectors = np.linalg.eig(chain.T)
    shares = np.real(vectors[:, np.argmin(abs(values - 1))])
    places = [model.state_space.unravel(state)[0] for state in range(len(chain))]
    shares = np.bincount(places, weights=shares / shares.sum())
    rooms = [places[leg.state] for leg in seen.legs]
    assert len(rooms) >= 16  # two rounds
    assert np.abs(np.bincount(rooms, minlength=6) - len(rooms) * shares).max() < 1.5  # by the round that has not ended


def test_a_part_of_a_day_of_the_patrol():
    """The whole of it, with twenty seeds, is ``python -m days``."""
    seen = days.day(2, 150)
    assert (seen.idle, seen.contacts) == (0.0, 0)
    assert len(seen.attended) > 5
    assert seen.longest < days.BOUND
    forecast = days.Forecast(seen.legs)
    own = [leg for leg in seen.legs if not leg.disturbed]
    assert len(own) > 3
    assert all(leg.action == forecast.actions[leg.state] for leg in seen.legs)
    assert all(forecast.following[leg.state][leg.following] > 0 for leg in own)


def a_day(seed, *, turns=0.0, count=4000):
    """Draw the legs of a patrol by its model, called away three times of ten, which may stay in a room by error."""
    random = np.random.default_rng(seed)
    forecast = days.Forecast([days.Leg(0, 0, 1, disturbed=False)])
    likely = [[int(each) for each in row.nonzero()[0]] for row in forecast.following]
    up_to = [np.cumsum(row[row > 0])[:-1].tolist() for row in forecast.following]
    found, state = [], 1
    for _ in range(count):
        is_away = random.random() < 0.3
        if is_away:
            following = int(random.integers(12))
        elif state // 2 == 3 and random.random() < turns:
            following = state
        else:
            following = likely[state][bisect(up_to[state], random.random())]
        found.append(days.Leg(state, forecast.actions[state], following, is_away))
        state = following
    return days.Day(idle=0.0, attended=[], left=[], waiting=[], contacts=0, failed=0, legs=found)


def test_the_check_of_a_day_finds_what_is_wrong_alone():
    right = [days.difference(a_day(seed)) for seed in range(20)]
    assert max(right) < days.ERRORS
    assert max(right) > 1  # its errors are no larger than chance makes them
    assert min(days.difference(a_day(seed, turns=0.5)) for seed in range(5)) > days.ERRORS
    whole = a_day(1)
    assert days.faults(whole, 86400) == []
    assert days.faults(replace(whole, idle=900.0), 86400) == ["idle for 900.0 s"]
    assert days.faults(replace(whole, waiting=[(301.0, "fire")]), 86400) == ["a call waited for 301.0 s"]
    assert days.faults(replace(whole, contacts=1), 86400) == ["1 contacts"]


def test_the_robot_sees_to_what_it_knows_of_alone():
    with modules("building"):
        sys.path.insert(0, str(EXAMPLES / "patrol"))
        example = import_module("building")
        told = []
        example.World.tell = told.append

        async def main():
            async with mdm.Runtime(log=None) as runtime:
                await runtime.start(example.building())
                for visit in example.building().present("intruder"):
                    example.building().go(visit)
                near, _ = (example.building().come("intruder", room) for room in ("SoccerField", "CoffeeRoom"))
                await example.warn_intruder()
                assert told == []
                example.World.known[near.number] = near
                drive = asyncio.create_task(example.warn_intruder())
                await asyncio.sleep(1)
                example.building().go(near)
                await drive
                assert told == []  # it has gone by itself
                assert len(example.building().present("intruder", "CoffeeRoom")) >= 1

        mdm.run(main, virtual=True)


def test_the_patrol_on_another_floor(tmp_path):
    """As docs/maps.md says how."""
    folder = tmp_path / "patrol"
    shutil.copytree(EXAMPLES / "patrol", folder, ignore=shutil.ignore_patterns("floor.*", "labels.png", "*.npz"))
    names = {
        "draw_floor.py": [
            (r"ROOMS = \{.*?\n\}", "ROOMS = {'Lobby': (0, 0, 8, 6), 'Office': (8, 0, 16, 6), 'Lab': (0, 6, 16, 14)}"),
            (r"DOORS = \(.*?\n\)", "DOORS = ((7.8, 2, 8.2, 3.4), (3, 5.8, 4.4, 6.2))"),
            (r"FURNITURE = .*?\n", "FURNITURE = ()\n"),
            (
                r"GOALS = \{.*?\n\}",
                (
                    "GOALS = {'Lobby': ((4, 3, 0), {'Right': 'Office', 'Up': 'Lab'}), "
                    "'Office': ((12, 3, 0), {'Left': 'Lobby'}), 'Lab': ((8, 10, 0), {'Down': 'Lobby'})}"
                ),
            ),
        ],
        "make_models.py": [("ElevatorHallway", "Office"), ("SoccerField", "Lab")],
        "patrol.toml": [
            ("ElevatorHallway.at_goal", "Office.at_goal"),
            ("SoccerField.at_goal", "Lab.at_goal"),
            ("(SouthCorridor|WestCorridor|CoffeeRoom) = .*?\n", ""),
            ("ElevatorHallway", "Office"),
            ("SoccerField", "Lab"),
            ("LRM", "Lobby"),
        ],
    }
    for name, changes in names.items():
        text = (folder / name).read_text()
        for old, new in changes:
            text = re.sub(old, new, text, flags=re.DOTALL)
        (folder / name).write_text(text)
        if name.endswith(".py"):
            assert script(folder / name).status == 0
    output = run(folder / "patrol.py", "--fast")
    assert "patrol (MDP, 6 states, 4 actions, event-driven)" in output
    assert "the state is 'Office, second half of the round': Left" in output
    assert "fault" not in output


def test_the_patrol_without_its_simulator_says_what_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "navground", None)
    done = script(PATROL)
    assert done.errors.startswith("patrol.py: simulated buildings need navground: pip install ")
    assert (done.status, done.errors.count("\n")) == (1, 1)


@pytest.mark.parametrize(("name", "seconds", "pictures"), [("film.gif", "2", 4), ("film.png", "1", 1)])
def test_the_patrol_is_filmed(tmp_path, name, seconds, pictures):
    output = run("patrol/patrol.py", "--fast", "--seconds", seconds, "--film", str(tmp_path / name))
    assert f"{name}: " in output
    with Image.open(tmp_path / name) as film:
        frames = getattr(film, "n_frames", 1)
        assert film.size[0] > 500
    assert frames == pictures  # of a GIF every half a second, from the beginning on


class Interrupted(io.TextIOWrapper):
    """Has Ctrl-C come where this is printed."""

    def __init__(self, words):
        super().__init__(io.BytesIO(), encoding="utf-8")
        self.words = words

    def write(self, text):
        written = super().write(text)
        if self.words in text:
            signal.raise_signal(signal.SIGINT)
        return written


def test_a_film_that_is_cut_off_shows_what_there_was_until_then(tmp_path):
    terminal = Interrupted("the robot is in WestCorridor")
    done = script(PATROL, "--fast", "--seconds", "60", "--film", tmp_path / "film.gif", output=terminal)
    assert (done.status, done.errors) == (130, "")
    terminal.flush()
    output = terminal.buffer.getvalue().decode()
    count = int(re.search(r"film.gif: (\d+) pictures\n", output)[1])
    assert count >= 5
    assert "stopped: the running action has ended, and the safe action has run" in output
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == count
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]


def same(one, other):
    """Whether two files hold the same, however they are packed."""
    if one.suffix == ".png":
        with Image.open(one) as made, Image.open(other) as kept:
            return made.mode == kept.mode and made.size == kept.size and made.tobytes() == kept.tobytes()
    if one.suffix != ".npz":
        return one.read_bytes() == other.read_bytes()
    with zipfile.ZipFile(one) as made, zipfile.ZipFile(other) as kept:
        return sorted(made.namelist()) == sorted(kept.namelist()) and all(
            made.read(name) == kept.read(name) for name in kept.namelist()
        )


@pytest.mark.parametrize(
    ("program", "names"),
    [
        ("patrol/draw_floor.py", ["floor.pgm", "floor.yaml", "floor.xml", "labels.png"]),
        ("patrol/make_models.py", ["top.pomdpx", "top.policy", "patrol.npz", "patrol.policy"]),
        pytest.param(
            "team/make_models.py", ["meeting.npz", "unloading.npz", "unloading.policy"], marks=pytest.mark.slow
        ),
        pytest.param(  # whose values compiled sweeps gave, to the last digit
            "team/building/make_models.py",
            ["building.npz", "building.policy"],
            marks=pytest.mark.compiled("sweeps"),
            id="team/building/make_models.py",
        ),
    ],
)
def test_the_files_of_examples_are_what_their_scripts_write(tmp_path, program, names):
    for folder in ("patrol", "team"):
        shutil.copytree(EXAMPLES / folder, tmp_path / folder)
    folder = (tmp_path / program).parent
    for name in names:
        (folder / name).unlink()
    done = script(tmp_path / program)
    assert (done.status, done.errors) == (0, "")
    assert [name for name in names if not same(folder / name, (EXAMPLES / program).parent / name)] == []
    if program == "team/make_models.py":  # where a search ends by its gap, vectors depend on the machine
        model = mdm.load_model(folder / "meeting.npz")
        values = [
            mdm.load_policy(place / "meeting.vf").value(model.initial_belief) for place in (folder, EXAMPLES / "team")
        ]
        assert values[0] == pytest.approx(values[1], abs=0.3)


def decided(name, seconds, look=lambda systems: None):
    """Run a team's example in virtual time; return what each agent's copy went through, by agent and step."""

    async def main():
        steps = {}
        async with running(EXAMPLES / "team" / name, delay=0.01) as (systems, _):
            for agent, system in systems.items():
                own = steps[agent] = {}

                def keep(commit, own=own):
                    own[commit.step] = (commit.input, commit.action, commit.digest)

                system.runtime.channel(f"{agent}/commits", Committed).subscribe(keep)
            for _ in range(10 * seconds):
                await asyncio.sleep(0.1)
                look(systems)
        return steps

    return mdm.run(main, virtual=True)


def test_two_robots_patrol_and_meet():
    seen = set()

    def look(systems):
        module = sys.modules["robots"]
        ada, bob = (module.ROOMS[robot.room] for robot in (module.ada, module.bob))
        seen.add((ada, bob, module.ada.news))

    with modules("robots", "make_models"):
        steps = decided("meeting.toml", 60, look)
    assert len(steps["ada"]) >= 110
    shared = steps["ada"].keys() & steps["bob"].keys()
    assert len(shared) >= 110
    assert all(steps["ada"][step] == steps["bob"][step] for step in shared)
    assert ("West", "East", False) in seen  # they patrol,
    assert ("Hall", "Hall", False) in seen  # and meet


def test_carriers_unload_one_at_a_time(capsys):
    with modules("carriers"):
        steps = decided("carriers.toml", 60)
    assert len(steps["a"]) >= 20
    assert steps["a"] == steps["d"]
    lines = capsys.readouterr().out.splitlines()
    assert lines.count("unloaded") >= 10
    assert lines.count("at the dock") >= lines.count("unloaded")
    for joint in {action for _, action, _ in steps["a"].values() if action is not None}:
        assert joint.split().count("Unload") <= 1


def test_robots_that_share_what_is_worth_it():
    seen = set()

    def look(systems):
        module = sys.modules["robots"]
        seen.add(tuple(module.ROOMS[robot.room] for robot in (module.ada, module.bob)))

    with modules("robots", "make_models"):
        steps = decided("communicating.toml", 60, look)
    assert min(map(len, steps.values())) >= 110
    assert {("West", "East"), ("Hall", "Hall")} <= seen


def patrolled(seconds):
    """Run the team in the building; return the joint steps, and of the robots the rooms, distances and touches.

    Each looks for the other where it is.
    """
    rooms, distances, touched = {"ada": [], "bob": []}, [], {}

    def look(systems):
        module = sys.modules["building"]
        poses = []
        for agent, system in systems.items():
            robot = getattr(module, agent).robot
            poses.append((robot.pose.x, robot.pose.y))
            touched[agent] = robot.collisions
            for room in system.places.floor.graph.names:
                if system.predicates.value(f"{room}.at_goal") and rooms[agent][-1:] != [room]:
                    rooms[agent].append(room)
        distances.append(math.dist(*poses))
        for agent, other, there in zip(systems, reversed(systems), reversed(poses), strict=True):
            seen = getattr(module, agent).building.guests[other].pose
            assert len(distances) < 50 or math.dist((seen.x, seen.y), there) < 0.25  # where it was 0.2 s ago

    with modules("building"):
        steps = decided("building/building.toml", seconds, look)
    return steps, rooms, distances, touched


@pytest.mark.parametrize("seconds", [80, pytest.param(240, marks=pytest.mark.slow)])
def test_two_robots_share_the_patrol_of_a_building(seconds):
    steps, rooms, distances, touched = patrolled(seconds)
    assert steps["ada"] == steps["bob"]
    assert touched == {"ada": 0, "bob": 0}
    assert min(distances) > 2.0  # it is what they decide that keeps them apart: they need not give way
    west, east = (set(rooms[agent][6:]) for agent in ("ada", "bob"))
    assert west == {"LRM", "SoccerField"}
    assert east == {"ElevatorHallway", "WestCorridor", "SouthCorridor", "CoffeeRoom"}
    ends = [room for room in rooms["bob"] if room in {"CoffeeRoom", "ElevatorHallway"}]
    assert all(one != other for one, other in itertools.pairwise(ends))  # there and back: no half of a round twice
    assert len(ends) >= seconds // 30
    assert len(rooms["ada"]) >= seconds * 32 // 240
    again, *_ = patrolled(seconds // 4)
    assert len(again["ada"]) >= seconds // 16
    for agent, own in again.items():
        assert own == {step: steps[agent][step] for step in own}


def test_what_a_communication_policy_is_worth():
    head, *rows = run("team/communicating.py", "--episodes", "10").splitlines()
    assert head.split() == ["communication", "policy", "return", "95", "%", "interval", "messages", "per", "step"]
    returns = {row.split()[0]: (float(row.split()[1]), float(row.split()[-1])) for row in rows}
    assert returns["Always()"][1] == 2.0
    assert returns["Never()"][1] == 0.0
    assert returns["ValueOfCommunication(0.05)"][1] < 1.0
    assert returns["Never()"][0] < returns["ValueOfCommunication(0.05)"][0]


def test_a_robot_is_controlled_from_off_board(capsys):
    with modules("doors"):
        steps = decided("offboard.toml", 30)
    assert len(steps["base"]) >= 50
    lines = capsys.readouterr().out.splitlines()
    assert sum("listens" in line for line in lines) >= 20
    assert sum("opens" in line for line in lines) >= 3


TEAMS = [
    ("meeting", ("ada", "bob"), 3),
    ("carriers", ("a", "b", "c", "d"), 3),
    ("offboard", ("base", "robot"), 3),
    ("communicating", ("ada", "bob"), 3),
    ("building/building", ("ada", "bob"), 2),
]


def test_the_team_that_the_readme_starts_is_one_that_is_tried():
    (block,) = (each for each in blocks.blocks("README.md") if each.info.get("checked") == "tests/test_examples.py")
    (started,) = re.findall(r"^mdm team up (\S+)", block.text, re.MULTILINE)
    assert started in {f"examples/team/{name}.toml" for name, *_ in TEAMS}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "agents", "times"), TEAMS)
def test_teams_run_in_processes_of_their_own(tmp_path, name, agents, times):
    for folder in ("team", "patrol"):
        shutil.copytree(EXAMPLES / folder, tmp_path / folder)
    for file in ("tiger.pomdp", "tiger.vf"):
        shutil.copy(EXAMPLES / file, tmp_path / file)
    path = tmp_path / "team" / f"{name}.toml"
    path.write_text(on_free_ports(path.read_text()))
    with up(path, "--decisions", tmp_path / "decided", "--record", tmp_path / "records") as team:
        for agent in agents:  # what a safe action says, as on a busy machine, is no decision
            team.hear(agent=agent, event="decision", times=times)
        team.hear(agent=agents[-1], event="output")
        team.process.send_signal(signal.SIGTERM)
        status, records = team.end()
    assert status == 128 + signal.SIGTERM
    assert not [record for record in records if record["event"] == "failed"]
    first, *others = histories(tmp_path / "decided").values()
    assert len(first) >= 2
    for other in others if name != "communicating" else ():
        shared = first.keys() & other.keys()
        assert len(shared) >= 2
        assert all(first[step] == other[step] for step in shared)
    command = [sys.executable, "-m", "mdm", "replay", str(tmp_path / "records")]
    replayed = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert replayed.stderr == ""
    assert replayed.returncode == 0, replayed.stdout
    assert ", 0 of them not sent" in replayed.stdout


def test_the_first_robot_works_and_then_charges():
    assert run("first.py") == "working\ncharging\n"
