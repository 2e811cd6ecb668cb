"""Potentials of ProbModelXML: the order of numbers, trees, shared branches, and where they are wrong."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import FormatError
from mdm.formats.markup import stream
from mdm.formats.openmarkov import PotentialReader, Variable, names_of, reference
from mdm.formats.source import Source
from mdm.models import Node

DOOR, AFTER, GUARD = Node("state", 0), Node("next_state", 0), Node("action", 0)
STATES = {"door": ("shut", "open"), "guard": ("wait", "close", "shout"), "wall": ("stone",), "stranger": ("a", "b")}
NODES = {("door", 0): DOOR, ("door", 1): AFTER, ("guard", 0): GUARD}
WORTH = '<Variable name="worth"/>'


def element(folder, text):
    (folder / "m.pgmx").write_text(text)
    (found,) = stream(Source(folder / "m.pgmx"), {text[1 : text.index(" ")]})
    return found


def find(each):
    name, time = reference(each)
    role = "utility" if name == "worth" else "chance"
    return Variable(name, time or 0, role, STATES.get(name, ()), None, each)


def variables(*names):
    return "".join(f'<Variable name="{name}" timeSlice="{time}"/>' for name, time in names)


def table(scope, numbers):
    return f'<Potential type="Table"><Variables>{scope}</Variables><Values>{numbers}</Values></Potential>'


def tree(top, *branches, scope=""):
    return (
        f'<Potential type="Tree/ADD"><Variables>{scope}</Variables>'
        f'<TopVariable name="{top}" timeSlice="0"/><Branches>{"".join(branches)}</Branches></Potential>'
    )


def branch(states, inside):
    listed = "".join(f'<State name="{name}"/>' for name in states)
    return f"<Branch><States>{listed}</States>{inside}</Branch>"


def read(folder, text, child=None):
    """Return a potential, as that of a child or a utility."""
    door = None if child is None else Variable("door", 1, "chance", STATES["door"], None, None)
    return PotentialReader(find, NODES, element(folder, text), door).potential()


def values(potential, child=None, **digits):
    known = {"door": DOOR, "guard": GUARD}
    chosen = {known[name]: np.array([value]) for name, value in digits.items()}
    return potential.rows(chosen, 1, child, 1 if child is None else 2)[0].tolist()


def test_the_first_variable_of_a_table_changes_fastest(tmp_path):
    found = read(tmp_path, table(variables(("door", 1), ("door", 0)), "0.75 0.25 0 1"), child=AFTER)
    assert [values(found, AFTER, door=door) for door in (0, 1)] == [[0.75, 0.25], [0, 1]]
    found = read(tmp_path, table(WORTH + variables(("door", 0), ("guard", 0)), "1 2 3 4 5 6"))
    assert [values(found, door=d, guard=g) for g in range(3) for d in range(2)] == [[n] for n in range(1, 7)]


def test_one_number_stands_for_all_and_constants_have_no_place(tmp_path):
    found = read(tmp_path, table(variables(("guard", 0), ("wall", 0)), "7"))
    assert found.scope == (GUARD,)
    assert [values(found, guard=g) for g in range(3)] == [[7]] * 3
    assert values(read(tmp_path, table("", "2.5"))) == [2.5]


def test_uniform(tmp_path):
    text = '<Potential type="Uniform"><Variables/></Potential>'
    assert values(read(tmp_path, text, child=AFTER), AFTER) == [0.5, 0.5]
    assert values(read(tmp_path, text)) == [0]


def test_branches_by_states_the_first_counts_and_a_label_is_read_once(tmp_path):
    found = read(
        tmp_path,
        tree(
            "guard",
            branch(["wait"], "<Label>calm</Label>" + table(variables(("door", 0)), "1 2")),
            branch(["wait", "close"], table("", "5")),
            branch(["shout"], "<Reference>calm</Reference>"),
        ),
    )
    assert [values(found, guard=g, door=1) for g in range(3)] == [[2], [5], [2]]
    assert found.branches[0] is found.branches[2]


def test_a_tree_over_a_constant_is_its_branch(tmp_path):
    assert values(read(tmp_path, tree("wall", branch(["stone"], table("", "3"))))) == [3]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (table(variables(("door", 0)), "1 2 3"), "3 numbers are given, but the table has 2 = 2"),
        (table(variables(("door", 0)), "1 x"), "'x' is not a number"),
        (table(variables(("door", 0)), "1 1e999"), "1e999 is not a finite number"),
        (table(variables(("door", 0), ("door", 0)), "1 2 3 4"), "lists a variable twice"),
        (table(variables(("stranger", 0)), "1 2"), "depends on 'stranger' of time slice 0, which is neither state"),
        ('<Potential type="Magic"/>', "of type 'Magic' is not supported"),
        (tree("guard", branch(["wait"], table("", "1"))), "the tree over 'guard' has no branch for close, shout"),
        (tree("guard", branch(["sleep"], table("", "1"))), "'guard' has no state 'sleep'; it has wait, close, shout"),
        (tree("guard", branch([], "<Reference>calm</Reference>")), "no branch with the label 'calm'; there are none"),
        (
            tree(
                "guard",
                branch([], "<Label>self</Label>" + tree("door", "<Branch><Reference>self</Reference></Branch>")),
            ),
            "refer to each other more than 100 deep",
        ),
        (tree("guard", "<Branch><Threshold/></Branch>"), "branches by thresholds"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path, text, words):
    with pytest.raises(FormatError) as caught:
        read(tmp_path, text)
    assert words in str(caught.value)
    assert caught.value.line == 1


@pytest.mark.parametrize(
    ("attributes", "found"),
    [('name="a" timeSlice="1"', ("a", 1)), ('name="a [0]"', ("a", 0)), ('name="a[2]"', ("a[2]", None))],
)
def test_references_name_the_time_slice_in_either_way(tmp_path, attributes, found):
    assert reference(element(tmp_path, f"<Variable {attributes}/>")) == found


def test_a_time_slice_is_a_number(tmp_path):
    with refused(FormatError):
        reference(element(tmp_path, '<Variable name="a" timeSlice="soon"/>'))


def test_names_are_those_of_the_states(tmp_path):
    text = '<Variable name="a"><States><State name="x"/><State name=" y "/></States></Variable>'
    assert names_of(element(tmp_path, text)) == ("x", "y")
    assert names_of(element(tmp_path, '<Variable name="a"/>')) == ()
