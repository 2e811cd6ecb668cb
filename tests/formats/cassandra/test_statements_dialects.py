"""Words of other dialects, and misspelt sections, are told as what they are."""

from __future__ import annotations

import pytest
from loading import load, written
from sentences import refused

from mdm import FormatError

HEAD = "discount: .9\nvalues: reward\nstates: a b\nactions: x\n"
TEAM = "agents: 2\ndiscount: 1\nvalues: reward\nstates: a b\nstart:\nuniform\nactions:\n2\n2\n"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (HEAD + "E: a\nobservations: p\nT: x\nidentity\n", 5, "'E:' names end states in a dialect of ZMDP"),
        (HEAD + "observations: p\nT: x\nidentity\nE: a\nO: x\nuniform\n", 8, "'E:' names end states"),
        (HEAD + "start: uniform\nE: b\nT: x\nidentity\n", 6, "'E:' names end states"),
        (HEAD + "atom: 3\nobservations: p\n", 5, "'atom' names the observations or states of an atomic proposition"),
        (HEAD + "observations: p\natom 0 : p\n\nT: x\nidentity\n", 6, "'atom' names the observations or states"),
        (HEAD + "observations: p q\natom 0: p\natom 1: q\nT: x\nidentity\n", 6, "take the line out"),
        (HEAD + "observations: p\nT: x\nidentity\natom 0 : p\nO: x\nuniform\n", 8, "'atom' names"),
        (HEAD + "observations: p\nprio 1 : b\nstart: uniform\n", 6, "'prio' gives states a priority"),
        (HEAD + "obersvations: p q\n", 5, "there is no section 'obersvations'; did you mean 'observations'?"),
        (HEAD + "strat: a\n", 5, "there is no section 'strat'; did you mean 'start'?"),
    ],
)
def test_what_a_line_of_another_dialect_is(tmp_path, text, line, words):
    with refused(FormatError) as caught:
        load(written(tmp_path, text, "x.pomdp"))
    assert caught.value.line == line
    assert words in str(caught.value)


def test_a_misspelt_section_of_a_team(tmp_path):
    with refused(FormatError) as caught:
        load(written(tmp_path, TEAM + "obsevations:\n2\n2\n", "x.dpomdp"))
    assert caught.value.line == 10


def test_names_may_be_words_of_dialects(tmp_path):
    text = HEAD.replace("a b", "E atom prio 3") + "T: x\nidentity\nR: x : atom : prio 1\n"
    assert load(written(tmp_path, text, "x.mdp")).state_space.names == ("E", "atom", "prio", "3")
