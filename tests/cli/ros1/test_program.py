"""The literal calls of the original's programs, in the ways in which they may be written."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from mdm.cli.ros1.program import programs, read_program


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
        'sl.addStateFactor ( StateDep().add ( 0, "A" ).add ( 0, "B" ) );',
        'StateDep d = StateDep().add ( "A" ).add ( "B" );\nsl.addStateFactor ( d );',
        'StateDep d;\nd.add ( "A" );\nd.add ( "B" );\nsl.addStateFactor ( d );',
        'const string a = "A";\nsl.addStateFactor ( StateDep().add ( a ).add ( std::string ( "B" ) ) );',
        'sl->addStateFactor ( StateDep() /* .add ( "C" ) */ .add ( "A" ) // .add ( "D" )\n .add ( "B" ) );',
    ],
)
def test_state_factors(tmp_path, code):
    program = read(tmp_path, f"StateLayer sl;\n{code}")
    assert [names for names, _ in program.states] == [["A", "B"]]
    assert program.notes.lines() == []


def test_names_that_are_made_are_told(tmp_path):
    program = read(tmp_path, "\n\nsl.addStateFactor ( StateDep().add ( prefix + name ) );")
    assert program.states == []
    (note,) = program.notes.lines()
    assert note.endswith("program.cpp:3: its names are not literal")


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ('"a/policy"', ("a/policy",)),
        ("argv[2]", (2,)),
        ('folder + "/policy"', (1, "/policy")),
        ("path", (1, "/x", "/policy")),
        ("path + made ( 3 )", None),
        ("other", None),
    ],
)
def test_arguments_of_controllers(tmp_path, argument, expected):
    code = 'const std::string folder = argv[1];\nstring path = folder + "/x" + "/policy";\nstring other = other;\n'
    program = read(tmp_path, f"{code}ControllerEventMDP cl ( {argument} );")
    assert [control.arguments for control in program.controls] == [[expected]]


def test_an_action_may_be_named_before_or_after_its_function(tmp_path):
    program = read(tmp_path, 'ActionLayer al;\nal.addAction ( work, "Work" );\nal.addAction ( "Rest", &rest );\n')
    assert [(action.name, action.routine.name) for action in program.actions] == [("Work", "work"), ("Rest", "rest")]


def test_programs_by_the_name_of_the_project(tmp_path):
    (tmp_path / "CMakeLists.txt").write_text(
        "project(robot)\nadd_executable(${PROJECT_NAME}_watch a.cpp b.cpp) # one\n"
    )
    for name in "ab":
        (tmp_path / f"{name}.cpp").touch()
    assert [path.name for path in programs(tmp_path)["robot_watch"]] == ["a.cpp", "b.cpp"]


def test_an_action_that_is_not_read_keeps_its_place(tmp_path):
    program = read(
        tmp_path, "ActionLayer al;\nal.addAction ( &go );\nal.addAction ( [] () {} );\nal.addAction ( &stop );"
    )
    assert [action.name for action in program.actions] == ["go", "action1", "stop"]
    assert len(program.notes.lines()) == 1


@given(st.text(st.sampled_from('ab(){}",;/*\\\n '), max_size=60))
def test_no_text_breaks_it(tmp_path_factory, text):
    program = read(tmp_path_factory.mktemp("code"), f"{text}\npm.addPredicate ( x ); al.addAction ( {text}")
    assert isinstance(program.notes.lines(), list)
