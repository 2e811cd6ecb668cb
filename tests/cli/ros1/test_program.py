"""The literal calls of the original's programs, in the ways in which they may be written."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from mdm.cli.ros1.program import read_program


def read(tmp_path, code):
    path = tmp_path / "program.cpp"
    path.write_text(code)
    return read_program([path], tmp_path)


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ('PV ( "A" )', "A"),
        ('"A"', "A"),
        ('Not ( "A" )', "not A"),
        ('And ( PV ( "A" ), Not ( PV ( "B" ) ) )', "(A and not B)"),
        ('Xor("A",Implies("B","C"))', "(A xor (B implies C))"),
        ('predicate_manager::Or ( "is it", "B", PV("C") )', "('is it' or B or C)"),
    ],
)
def test_formulas(tmp_path, formula, expected):
    program = read(tmp_path, f'PropLogicPredicate p ( "N", {formula} );\npm.addPredicate ( p );')
    (declared,) = program.declarations
    assert (declared.name, declared.kind, declared.formula) == ("N", "formula", expected)


def test_a_formula_that_is_not_literal_is_the_robot_s(tmp_path):
    program = read(tmp_path, 'PropLogicEvent e ( "N", made_elsewhere );\npm.addEvent ( e );')
    (declared,) = program.declarations
    assert (declared.name, declared.kind, declared.event) == ("N", "sensor", True)
    assert declared.about == "PropLogicEvent (made_elsewhere)"


@pytest.mark.parametrize(
    "code",
    [
        'sl.addStateFactor(StateDep().add("A").add("B"));',
        'StateDep d = StateDep().add ( "A" ).add ( "B" );\nsl.addStateFactor ( d );',
        'StateDep d;\nd.add ( "A" );\nd.add ( "B" );\nsl.addStateFactor ( d );',
        'const string a = "A";\nsl.addStateFactor ( StateDep().add ( a ).add ( std::string ( "B" ) ) );',
        'sl->addStateFactor ( StateDep() /* .add ( "C" ) */ .add ( "A" ) // .add ( "D" )\n .add ( "B" ) );',
    ],
)
def test_state_factors(tmp_path, code):
    program = read(tmp_path, f"StateLayer sl;\n{code}")
    assert [names for names, _ in program.states] == [["A", "B"]]
    assert program.notes == []


def test_names_that_are_made_are_told(tmp_path):
    program = read(tmp_path, "\n\nsl.addStateFactor ( StateDep().add ( prefix + name ) );")
    assert program.states == []
    (note,) = program.notes
    assert note.endswith("program.cpp:3: its names are not literal")


def test_an_action_that_is_not_read_keeps_its_place(tmp_path):
    program = read(
        tmp_path, "ActionLayer al;\nal.addAction ( &go );\nal.addAction ( [] () {} );\nal.addAction ( &stop );"
    )
    assert [action.name for action in program.actions] == ["go", "action1", "stop"]
    assert len(program.notes) == 1


@given(st.text(st.sampled_from('ab(){}",;/*\\\n '), max_size=60))
def test_no_text_breaks_it(tmp_path_factory, text):
    program = read(tmp_path_factory.mktemp("code"), f"{text}\npm.addPredicate ( x ); al.addAction ( {text}")
    assert isinstance(program.notes, list)
