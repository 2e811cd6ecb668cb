"""Records of programs: what each command says of a record that a Python program made."""

from __future__ import annotations

import runpy

import pytest
from places import EXAMPLES

from mdm.cli.records.page import recorded_run

pytestmark = pytest.mark.usefixtures("recorded_here")
BEHIND = "        battery_is_low.set(True)"


def test_the_record_of_the_first_program_is_whole(mdm, tmp_path, capsys):
    program, place = (EXAMPLES / "first.py").read_text(), tmp_path / "run.mcap"
    for before, after in (
        ("mdm.Runtime()", f"mdm.Runtime(record={str(place)!r})"),
        ("mdm.run(main)", "mdm.run(main, virtual=True)"),
        (BEHIND, f"        print(runtime.explain('robot'))\n{BEHIND}"),
    ):
        assert program.count(before) == 1
        program = program.replace(before, after)
    (tmp_path / "first.py").write_text(program)
    runpy.run_path(str(tmp_path / "first.py"))
    said = capsys.readouterr().out.splitlines()
    status, output, errors = mdm("record", "info", place)
    assert (status, errors) == (0, "")
    assert "configuration           system.json" in output
    assert not [line for line in output if line.startswith("not in the record")]
    first = mdm("explain", place, "--at", "0.05s")[1]
    assert first[1:3] == ["Decision 0: 'work', by values of actions per state.", "The state was full."]
    assert said == ["working", *first[1:], "charging"]
    last = mdm("explain", place)[1]
    assert last[1:3] == ["Decision 1: 'charge', by values of actions per state.", "The state was low."]
    assert mdm("replay", place)[:2] == (0, ["2 decisions recorded, 2 replayed: all the same (bit by bit)"])
    status, output, _ = mdm("statistics", place)
    assert status == 0
    assert output[0].startswith("robot: 2 decisions in 1 chain")
    run = recorded_run(place)
    assert [each.name for each in run.scene().predicates] == ["BatteryIsLow"]
    assert [run.frame(time).predicates for time in (0.05, 0.1)] == [(False,), (True,)]
    assert run.scene().remarks == ()
    status, output, errors = mdm("statistics", place, "--ensemble", "rover")
    assert status == 1
    assert "0 models in the record are meant, of ensembles robot: give --ensemble or --model" in errors
