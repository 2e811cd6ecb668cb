from __future__ import annotations

from mdm.team.agreement.messages import START, Commit, Position, Term, contains
from mdm.team.agreement.state import TERMS, Log


def commit(number, step, previous, missing=(), command=None):
    term = Term(number, "a", 1)
    return Commit(term, step, START.term if previous == 0 else Term(previous, "a", 1), {}, missing, command, "", "")


def history(*numbers, size=256):
    """A history whose steps are of these terms."""
    made = Log(size, 3)
    for step, (number, previous) in enumerate(zip(numbers, (0, *numbers), strict=False), 1):
        assert made.follows(commit(number, step, previous))
        made.append(commit(number, step, previous))
    return made


def at(number, step):
    return Position(Term(number, "a", 1), step)


def test_the_next_step_follows_the_term_of_the_last():
    made = history(1, 1, 3)
    assert made.position == at(3, 3)
    assert made.follows(commit(4, 4, 3))
    assert not made.follows(commit(4, 4, 2))
    assert not made.follows(commit(4, 5, 3))


def test_a_lineage_tells_which_histories_go_on_from_each_other():
    made = history(1, 1, 3, 3)
    for position in (START, at(1, 1), at(1, 2), at(3, 3), at(3, 4)):
        assert contains(made.lineage, position)
    for position in (at(1, 3), at(2, 3), at(3, 5), at(4, 1)):
        assert not contains(made.lineage, position)


def test_what_follows_a_position_is_in_the_log_or_forgotten():
    made = history(*[1] * 9, size=4)
    assert [entry.step for entry in made.since(at(1, 7), 10)] == [8, 9]
    assert [entry.step for entry in made.since(at(1, 5), 2)] == [6, 7]
    assert made.since(at(1, 9), 10) == ()
    assert made.since(at(1, 1), 10) is None
    assert made.since(at(2, 8), 10) is None
    assert len(made.commits) < 8


def test_terms_beyond_a_number_are_forgotten():
    made = history(*range(1, TERMS + 3))
    assert len(made.lineage) == TERMS
    assert not contains(made.lineage, START)


def test_another_history_has_no_log():
    made = history(1, 1)
    made.replace((START, at(4, 7)), 2)
    assert (made.position, made.side, made.commits) == (at(4, 7), 2, [])
    assert made.since(START, 9) is None


def test_the_side_is_who_took_part_in_the_last_step_but_for_commands():
    made = history(1)
    made.append(commit(1, 2, 1, ("b",)))
    made.append(commit(1, 3, 1, (), "stop"))
    assert made.side == 2
