"""Single entries that are read in blocks, against the words they stand in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from mdm.formats.cassandra.statements import Entries


class Stored:
    """Keeps what entries are stored, one by one, with None for each field that was ``*``."""

    def __init__(self, words, names=9):
        self.found = []
        self.entries = Entries(words, lambda at: None, self.symbol, self.store)
        self.names = names

    def symbol(self, kind, letter, at, words):
        (word,) = words
        return int(word) if word.isdecimal() and int(word) < self.names else None

    def store(self, kind, action, places, values):
        for index in range(np.size(values)):
            one = [place if place is None else int(place[index]) for place in places]
            self.found.append((kind, action, *one, float(np.atleast_1d(values)[index])))


def statement(kind, *fields, value):
    return [kind, ":", *" : ".join(map(str, fields)).split(), str(value)]


FIELDS = [(2, 3, "a"), (4, 5, "s"), (6, 7, "n")]
NAMED = (False, False, False)


@given(st.lists(st.tuples(*[st.integers(0, 8)] * 3, st.sampled_from([0.0, 0.5, 1.0])), min_size=1, max_size=200))
def test_entries_are_stored_action_by_action_in_their_order(rows):
    words = [word for *fields, value in rows for word in statement("T", *fields, value=value)]
    stored = Stored(words)
    stored.entries.learn("T", words[: len(words) // len(rows)], FIELDS, NAMED)
    assert stored.entries.read("T", 0) == len(words)
    assert stored.found == []
    stored.entries.flush("T")
    assert stored.found == [("T", *row) for row in sorted(rows, key=lambda row: row[0])]
    stored.entries.flush("T")
    assert len(stored.found) == len(rows)


@pytest.mark.parametrize(
    "other",
    [
        statement("T", 1, 2, "*", value=1),
        statement("T", 1, 2, 10, value=1),
        statement("T", 1, 2, 3, value="uniform"),
        statement("T", 1, 2, 3, value=-0.5),
        statement("T", 1, 2, 3, value="nan"),
        statement("T", 1, 2, 3, value="1_0"),
        statement("R", 1, 2, 3, value=1),
        ["T", ":", "1"],
    ],
)
@pytest.mark.parametrize("before", [1, 15, 16, 17, 70])
def test_reading_stops_where_the_form_does(before, other):
    known = statement("T", 1, 2, 3, value=0.5)
    stored = Stored(known * before + other + known * 3)
    stored.entries.learn("T", known, FIELDS, NAMED)
    assert stored.entries.read("T", 0) == before * len(known)
    stored.entries.flush("T")
    assert stored.found == [("T", 1, 2, 3, 0.5)] * before


def test_a_form_that_is_not_known_or_does_not_fit_reads_nothing():
    words = statement("T", 1, 2, 3, value="uniform")
    stored = Stored(words)
    assert stored.entries.read("T", 0) == 0
    stored.entries.learn("T", words, FIELDS, NAMED)
    assert stored.entries.read("T", 0) == 0


def test_rewards_may_be_negative_and_wild_fields_stand_for_all():
    words = statement("R", "*", 2, "*", value=-1) + statement("R", "*", 3, "*", value=-2.5)
    stored = Stored(words)
    stored.entries.learn("R", words[: len(words) // 2], [(4, 5, "s")], (True, False, True))
    assert stored.entries.read("R", 0) == len(words)
    stored.entries.flush("R")
    assert stored.found == [("R", None, 2, None, -1), ("R", None, 3, None, -2.5)]


def test_another_form_of_a_kind_stores_what_was_kept():
    stored = Stored([])
    stored.entries.add("T", (False, False, False), [[0], [1], [2]], [0.5])
    stored.entries.add("T", (False, False, True), [[0], [1]], [0.25])
    assert stored.found == [("T", 0, 1, 2, 0.5)]
    stored.entries.flush("T")
    assert stored.found[1:] == [("T", 0, 1, None, 0.25)]
