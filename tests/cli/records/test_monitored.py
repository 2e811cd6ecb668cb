"""`mdm verify FILE.mcap`: the verdict on a run, its first violation and what led there, wrong input."""

from __future__ import annotations

import asyncio
import json

import pytest
from places import TIGER, TIGER_VECTORS
from records import Writing, decision
from shown import a_robot
from team_file import running, write

from mdm import load_system, run
from mdm.testing import run_virtual

pytestmark = pytest.mark.usefixtures("recorded_here")


@pytest.fixture
def record(tmp_path):
    """Return a record of 10.5 seconds: low from 4 s to 4.8 s and from 10 s on, near from .6 s to 2 s, from 3.4 s …"""
    file = a_robot(tmp_path)
    text = file.read_text(encoding="utf-8")
    monitors = 'Careful = { monitor = "G(not (Low and Near))" }\n[ensembles.top]\n'
    file.write_text(text.replace("[ensembles.top]\n", monitors, 1), encoding="utf-8")

    async def run(runtime):
        await runtime.start(load_system(file))
        await asyncio.sleep(10.5)

    run_virtual(run, record=tmp_path / "run.mcap")
    return tmp_path / "run.mcap"


def test_the_first_violation_and_what_led_to_it(mdm, record):
    status, lines, errors = mdm("verify", record, "G(Low implies Near U not Low) and G(not Low or Quiet)")
    assert (status, errors) == (1, "")
    assert lines == [
        "verdict             false for ever",
        "violated at         4 s",
        "led there by        0 s         top/walk decides 0",
        "                    0.6 s       top/walk decides 1",
        "                    2 s         Quiet is true",
        "                    2 s         top/walk decides 0",
        "                    3.4 s       Near is true",
        "                    3.4 s       Quiet is false",
        "                    3.4 s       top/walk decides 1",
        "                    4 s         Low is true",
    ]


def test_the_facts_as_json(mdm, record):
    facts = json.loads(mdm("verify", record, "G(not Low)", "--json")[1][0])
    led = facts.pop("led")
    assert facts == {"verdict": False, "holds": False, "seconds": 4.0}
    assert led[0] == {"seconds": 0.0, "predicate": "Low", "is": False}
    assert led[-1] == {"seconds": 4.0, "predicate": "Low", "is": True}
    assert {"seconds": 3.4, "ensemble": "top/walk", "decides": "1"} in led
    assert all(each["seconds"] < 4.0 for each in led if "decides" in each)


@pytest.mark.parametrize(
    ("formula", "status", "expected"),
    [
        ("F(Low)", 0, ["verdict             true for ever", "since               4 s"]),
        ("G(Low implies F(not Low))", 0, ["verdict             open: it does not hold so far"]),
        ("G(Low or not Low implies F(Near or not Near))", 0, ["verdict             true for ever"]),
        ("F(Low and X(not Low)) and G(F(Near) or Low)", 0, ["verdict             open: it holds so far"]),
        ("G(Near) and F(not Near)", 1, ["verdict             false for ever", "violated at         0 s"]),
    ],
)
def test_what_holds_and_what_is_open(mdm, record, formula, status, expected):
    found = mdm("verify", record, formula)
    assert (found[0], found[1][: len(expected)], found[2]) == (status, expected, "")


def test_a_monitor_of_the_run_saw_the_same(mdm, record):
    both = [json.loads(mdm("verify", record, each, "--json")[1][0]) for each in ("G(Careful)", "G(not (Low and Near))")]
    assert both[0]["seconds"] == both[1]["seconds"] == 4.0


def test_a_record_whose_process_was_killed_is_judged_up_to_there(mdm, record):
    whole = record.read_bytes()
    record.write_bytes(whole[: len(whole) * 2 // 3])
    status, lines, errors = mdm("verify", record, "G(not (Low and Near))")
    assert (status, lines[0]) in {
        (0, "verdict             open: it holds so far"),
        (1, "verdict             false for ever"),
    }
    assert "what follows is not there" in errors


@pytest.mark.parametrize(
    ("formula", "sentence"),
    [
        ("G(not Lwo)", "{record}: there is no predicate 'Lwo' in this record; did you mean 'Low'?"),
        ("G(stairs)", "{record}: there is no predicate 'stairs' in this record; there are Low, Near, Quiet, Careful"),
        (
            "G(not Low",
            (
                "the formula does not parse at column 10: ')' was expected, not 'the end'; a record takes a formula in "
                "time, such as 'G(not Stairs)'"
            ),
        ),
        ("G(true)", "a monitor has 1 to 8 predicates, not 0"),
    ],
)
def test_a_wrong_formula_is_a_sentence(mdm, record, formula, sentence):
    assert mdm("verify", record, formula) == (1, [], f"mdm verify: {sentence.format(record=record)}\n")


@pytest.mark.parametrize(
    "arguments", [("robot", "G(Low)"), *(("G(Low)", option, "1") for option in ("--from", "--seed", "--bounds"))]
)
def test_arguments_for_models_are_refused(mdm, record, arguments):
    status, lines, errors = mdm("verify", record, *arguments)
    assert (status, lines) == (2, [])
    assert "a record takes a formula in time, --config and --json; all else is for models" in errors


def test_records_without_predicates_or_without_a_beginning(mdm, tmp_path):
    simulated, bare = tmp_path / "simulated.mcap", tmp_path / "bare.mcap"
    mdm("simulate", TIGER, TIGER_VECTORS, "--steps", 5, "--seed", 1, "--record", simulated)
    sentence = f"mdm verify: {simulated}: there is no predicate 'Low' in this record; it has none\n"
    assert mdm("verify", simulated, "G(Low)") == (1, [], sentence)
    writing = Writing(bare)
    writing.write("decisions", decision(1))
    writing.close()
    assert "the record has no beginning" in mdm("verify", bare, "G(Low)")[2]


def test_another_file_of_the_run(mdm, record, tmp_path):
    given = ("G(not Low)", "--config", tmp_path / "robot.toml")
    assert mdm("verify", record, *given)[1][1] == "violated at         4 s"
    assert "no such file" in mdm("verify", record, "G(Low)", "--config", tmp_path / "none.toml")[2]


def test_a_monitor_over_teammates_and_the_record_of_an_agent(mdm, tmp_path):
    """An agent's own predicates are without its name, in the monitor and in its record."""
    path = write(tmp_path, ("InLab = {}", 'InLab = {}\nApart = { monitor = "G(not (a/InLab and b/InLab))" }'))

    async def main():
        async with running(path, records=tmp_path / "records") as (systems, _):
            await asyncio.sleep(1.0)
            for system in systems.values():
                system.predicates.sense("InLab", True)
                await asyncio.sleep(1.0)
            return [system.predicates.verdict("Apart") for system in systems.values()]

    assert run(main, virtual=True) == [False, False]
    for name, formula in (("a", "G(not (InLab and b/InLab))"), ("b", "G(not (a/InLab and InLab))"), ("b", "G(Apart)")):
        status, lines, errors = mdm("verify", tmp_path / "records" / f"{name}.mcap", formula)
        assert (status, lines[0], errors) == (1, "verdict             false for ever", "")
