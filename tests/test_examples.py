"""Every example runs, and does what it says."""

from __future__ import annotations

import subprocess
import sys

import pytest
from places import EXAMPLES


def run(name, *arguments):
    done = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / name), *arguments], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def test_q_table():
    assert run("q_table.py") == "working\ncharging\n"


def test_embedding():
    lines = run("embedding.py").splitlines()
    assert lines[:4] == ["waiting", "fan on", "fan off", "waiting"]
    assert lines[-1] == "the program went on meanwhile: True"


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


def test_tree_search():
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


@pytest.mark.parametrize("arguments", [["--fast"], ["--fast", "--seconds", "5"]])
def test_patrol(arguments):
    output = run("patrol/patrol.py", *arguments)
    assert "Patrol: patrol (POMDP, 12 states, 4 actions, event-driven)" in output
    assert "the state is 'person': Assistance" in output
    assert "Patrol preempted" in output
    assert "the robot's motors are off" in output
    if len(arguments) == 1:
        for words in (
            "FireIsConfirmed is true now",
            "Emergency succeeded",
            "Trespassing succeeded",
            "Assistance succeeded",
        ):
            assert words in output
    again = run("patrol/patrol.py", *arguments)
    assert output.splitlines()[:-1] == again.splitlines()[:-1]  # the last line tells the time it took


def test_the_patrol_s_policies_can_be_made_again(tmp_path):
    """The files of the example are what its script writes."""
    import shutil

    folder = tmp_path / "patrol"
    shutil.copytree(EXAMPLES / "patrol", folder)
    for name in ("rooms.pomdpx", "rooms.vf", "top.policy"):
        (folder / name).unlink()
    subprocess.run([sys.executable, str(folder / "make_models.py")], check=True, capture_output=True, timeout=100)
    for name in ("rooms.pomdpx", "top.policy"):
        assert (folder / name).read_text() == (EXAMPLES / "patrol" / name).read_text()
    assert (folder / "rooms.vf").read_text().count("-1\n") == (EXAMPLES / "patrol" / "rooms.vf").read_text().count(
        "-1\n"
    )
