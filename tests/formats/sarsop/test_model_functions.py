"""Functions of POMDPX: tables of entries, decision diagrams, and where they are wrong."""

from __future__ import annotations

import numpy as np
import pytest

from mdm import FormatError
from mdm.formats.markup import stream
from mdm.formats.sarsop.model import Variable, function
from mdm.formats.source import Source
from mdm.models import Factor, Node

LAMP, AFTER, DOOR, ACT = Node("state", 0), Node("next_state", 0), Node("state", 1), Node("action", 0)
VARIABLES = {
    "lamp0": Variable(LAMP, Factor("lamp0", ["off", "on"])),
    "lamp1": Variable(AFTER, Factor("lamp1", ["off", "on"])),
    "door0": Variable(DOOR, Factor("door0", ["s0", "s1", "s2"])),
    "act": Variable(ACT, Factor("act", ["wait", "press"])),
}
SIZES = {LAMP: 2, AFTER: 2, DOOR: 3, ACT: 2}


def read(folder, inside, parents="null", *, child=None, kind="TBL"):
    text = f'<Func name="f"><Parent>{parents}</Parent><Parameter type="{kind}">{inside}</Parameter></Func>'
    (folder / "m.pomdpx").write_text(text)
    (element,) = stream(Source(folder / "m.pomdpx"), {"Func"})
    return function(element, VARIABLES, None if child is None else VARIABLES[child])


def entries(*rows, table="ProbTable"):
    return "".join(f"<Entry><Instance>{words}</Instance><{table}>{given}</{table}></Entry>" for words, given in rows)


def array(potential, *scope):
    """Return the numbers of a potential over some variables."""
    grid = np.indices([SIZES[node] for node in scope]).reshape(len(scope), -1)
    found = potential.rows(dict(zip(scope, grid, strict=True)), grid.shape[1] if scope else 1, None, 1)
    return found.reshape([SIZES[node] for node in scope])


def test_later_entries_count_and_what_none_names_is_0(tmp_path):
    rows = [("* off -", "1 0"), ("press on -", "0.25 0.75"), ("wait * -", "0.5 0.5")]
    found = read(tmp_path, entries(*rows), "act lamp0", child="lamp1")
    expected = [[[0.5, 0.5], [0.5, 0.5]], [[1, 0], [0.25, 0.75]]]
    np.testing.assert_array_equal(found.values, expected)
    found = read(tmp_path, entries(("s1", "-7"), table="ValueTable"), "door0")
    np.testing.assert_array_equal(array(found, DOOR), [0, -7, 0])


def test_what_no_entry_tells_apart_is_left_out(tmp_path):
    found = read(tmp_path, entries(("* * -", "uniform")), "act door0", child="lamp1")
    assert found.scope == (AFTER,)
    np.testing.assert_array_equal(found.values, [0.5, 0.5])


def test_numbers_for_several_values_go_with_the_last_fastest(tmp_path):
    found = read(tmp_path, entries(("- -", "1 2 3 4 5 6"), table="ValueTable"), "lamp0 door0")
    np.testing.assert_array_equal(array(found, LAMP, DOOR), [[1, 2, 3], [4, 5, 6]])
    found = read(tmp_path, entries(("- -", "identity")), "lamp0", child="lamp1")
    np.testing.assert_array_equal(found.values, np.eye(2))


DIAGRAM = """<DAG><Node var="act">
<Edge val="wait"><SubDAG type="persistent" var="lamp1"/></Edge>
<Edge val="press"><Node var="door0">
<Edge val="s0"><SubDAG type="template" idref="often"/></Edge>
<Edge val="s1"><SubDAG type="deterministic" var="lamp1" val="on"/></Edge>
<Edge val="s2"><SubDAG type="uniform" var="lamp1"/></Edge></Node></Edge></Node></DAG>
<SubDAGTemplate id="often"><Node var="lamp1"><Edge val="on"><Terminal>0.75</Terminal></Edge></Node></SubDAGTemplate>"""


def test_diagrams_with_shortcuts_and_templates(tmp_path):
    found = read(tmp_path, DIAGRAM, "act lamp0 door0", child="lamp1", kind="DD")
    wait, press = array(found, ACT, DOOR, LAMP, AFTER)
    for door in range(3):
        np.testing.assert_array_equal(wait[door], np.eye(2))
    # an edge that is missing is 0, as an entry is
    np.testing.assert_array_equal(press[:, 0], [[0, 0.75], [0, 1], [0.5, 0.5]])
    np.testing.assert_array_equal(press[:, 1], press[:, 0])


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        (entries(("on", "1")), "1 words are given, but the function is over 2: lamp0 door0"),
        (entries(("dim s0", "1")), "dim"),
        (entries(("- s0", "1")), "1 numbers are given, but the variables with '-' have 2 combinations"),
        (entries(("on s0", "much")), "'much' is not a finite number"),
        (entries(("on -", "uniform")), "'uniform' needs a distribution"),
        (entries(("- -", "identity")), "'identity' needs two '-' for variables of one size"),
        ("<Entry><Instance>on s0</Instance></Entry>", "<Entry> needs a <ProbTable>"),
    ],
)
def test_wrong_entries_are_told(tmp_path, inside, words):
    with pytest.raises(FormatError, match=words):
        read(tmp_path, inside, "lamp0 door0")


WAIT = '<Edge val="wait"><Terminal>1</Terminal></Edge>'
ITSELF = '<SubDAG type="template" idref="a"/>'


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ("<DAG/>", "<DAG> needs one <Node>, <Terminal> or <SubDAG>, not 0"),
        ("<DAG><Leaf/></DAG>", "was expected, not <Leaf>"),
        ("<DAG><Terminal>nan</Terminal></DAG>", "'nan' is not a finite number"),
        ('<DAG><Node var="moon"/></DAG>', "no variable 'moon' here"),
        (
            f'<DAG><Node var="act">{2 * WAIT}</Node></DAG>',
            "a second edge for 'wait'",
        ),
        ('<DAG><SubDAG type="even" var="act"/></DAG>', "type 'even': uniform"),
        ('<DAG><SubDAG type="persistent" var="act"/></DAG>', "'act' is not a state variable"),
        ('<DAG><SubDAG type="template" idref="no"/></DAG>', "no template 'no'; there are none"),
        (
            f'<DAG>{ITSELF}</DAG><SubDAGTemplate id="a">{ITSELF}</SubDAGTemplate>',
            "refer to each other more than 100 deep",
        ),
    ],
)
def test_wrong_diagrams_are_told(tmp_path, inside, words):
    with pytest.raises(FormatError, match=words):
        read(tmp_path, inside, "lamp0", kind="DD")


@pytest.mark.parametrize(
    ("parents", "kind", "words"),
    [
        ("sun", "TBL", "no variable 'sun' here; there are lamp0, lamp1, door0, act"),
        ("act act", "TBL", "lists a variable twice"),
        ("act", "XX", "a function of type 'XX' is neither TBL nor DD"),
    ],
)
def test_what_is_no_function_is_told(tmp_path, parents, kind, words):
    with pytest.raises(FormatError, match=words):
        read(tmp_path, "", parents, kind=kind)
