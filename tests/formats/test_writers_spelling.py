"""Names in one word each: distinct, allowed, and told where they were changed."""

from __future__ import annotations

import re
import warnings

import pytest
from hypothesis import given, strategies as st

from mdm import ModelWarning
from mdm.formats.writers import Speller, unused

FOREIGN = re.compile(r"[^A-Za-z0-9_]+")
NAMES = st.lists(st.text(alphabet="ab_ 012:*é", max_size=4) | st.sampled_from(["all", "T"]), unique=True, max_size=8)


@given(NAMES, st.sets(st.sampled_from(["a", "b", "_", "a_2"])))
def test_words_differ_and_are_allowed(names, taken):
    words = Speller(FOREIGN, {"all", "T"}).spell(names, taken)
    assert len(set(words)) == len(words) == len(names)
    for index, (name, word) in enumerate(zip(names, words, strict=True)):
        assert word
        assert not FOREIGN.search(word)
        assert word not in taken | {"all", "T"}
        assert not word.isdecimal() or word == str(index)
        plain = not FOREIGN.search(name) and name not in taken | {"all", "T", ""} and not name.isdecimal()
        if plain and name not in words[:index]:
            assert word == name


def test_what_was_changed_is_told_once_at_the_end():
    speller = Speller(FOREIGN)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert speller.spell(["plain", "0"], numbered=False) == ["plain", "0"]
        speller.warn("FORMAT")
        assert speller.spell(["a b", "a_b", "7", "*", "+"]) == ["a_b", "a_b_2", "_7", "_", "__2"]
    with pytest.warns(ModelWarning, match=r"5 names not allowed in FORMAT were changed.*: 'a b' as 'a_b', .*, …$"):
        speller.warn("FORMAT")


def test_the_first_number_that_makes_a_word_unused():
    assert unused("a", {"b"}.__contains__) == "a"
    assert unused("a", {"a", "a_2", "a_4"}.__contains__) == "a_3"
