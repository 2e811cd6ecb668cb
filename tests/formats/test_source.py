"""The text of a file, and the places of its words."""

from __future__ import annotations

import gzip
import os

import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm import FormatError, load_model, load_policy
from mdm.formats.source import Source, Words, number, suffixes

TEXT = "first é\nsecond\n"


def source_of(folder, text, name="model.pomdp"):
    (folder / name).write_text(text)
    return Source(folder / name)


@pytest.mark.parametrize(
    "data",
    [
        TEXT.encode(),
        b"\xef\xbb\xbf" + TEXT.encode(),
        TEXT.encode("latin-1"),
        TEXT.replace("\n", "\r\n").encode(),
        TEXT.replace("\n", "\r").encode(),
        gzip.compress(TEXT.encode(), mtime=0),
    ],
)
def test_a_text_is_the_same_however_it_is_stored(tmp_path, data):
    (tmp_path / "model.pomdp").write_bytes(data)
    assert Source(tmp_path / "model.pomdp").text == TEXT


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("m.pomdp", lambda path: None, "there is no such file"),
        ("m.pomdp", lambda path: path.mkdir(), "a folder, not a file"),
        ("m.pomdp", lambda path: path.write_bytes(b" \n"), "empty"),
        ("m.pomdp", lambda path: path.write_bytes(b"a\0b"), "binary"),
        ("m.pomdp.gz", lambda path: path.write_bytes(b"states: 2"), "named .gz, but is not gzipped"),
        ("m.pomdp.gz", lambda path: path.write_bytes(gzip.compress(b"states: 2")[:-9]), "truncated or damaged"),
    ],
)
def test_what_is_no_text_is_refused(tmp_path, name, make, words):
    make(tmp_path / name)
    with pytest.raises(FormatError, match=words) as caught:
        Source(tmp_path / name)
    assert caught.value.file == str(tmp_path / name)


@given(st.text(alphabet="ab \n", min_size=1).filter(str.strip), st.data())
def test_a_place_is_the_line_and_column_of_a_character(tmp_path_factory, text, data):
    source = source_of(tmp_path_factory.mktemp("source"), text)
    position = data.draw(st.integers(0, len(text) - 1))
    line, column = source.place(position)
    assert (text.split("\n")[line - 1] + "\n")[column - 1] == text[position]


def test_words_in_the_manner_of_cassandra(tmp_path):
    text = "T: go:*: s1 - 0.5 + .5 # all of it\n#nothing\n-x 1e-3 a-b\n"
    words = ["T", ":", "go", ":", "*", ":", "s1", "-0.5", "+.5", "-x", "1e-3", "a-b"]
    assert Words(source_of(tmp_path, text)).words == words
    assert Words(source_of(tmp_path, text), skip=2).words == words[-3:]
    assert Words(source_of(tmp_path, text), skip=9).words == []


@given(
    st.lists(st.sampled_from(["a", "bc", ":", "*", "-1", "7", "\n", "#x y\n", "  "]), min_size=1, max_size=30),
    st.data(),
)
def test_a_wrong_word_is_told_where_it_stands(tmp_path_factory, pieces, data):
    text = " ".join([*pieces, "end"])
    words = Words(source_of(tmp_path_factory.mktemp("source"), text))
    at = data.draw(st.integers(0, len(words.words) - 1))
    with pytest.raises(FormatError) as caught:
        words.fail(at, "wrong")
    line = text.split("\n")[caught.value.line - 1]
    assert line[caught.value.column - 1 :].startswith(words.words[at])
    assert words.words[:at].count(words.words[at]) == _before(text, caught.value, words.words[at])


def _before(text, error, word):
    """Count the same word before the place of an error, outside comments."""
    lines = text.split("\n")[: error.line]
    lines[-1] = lines[-1][: error.column - 1]
    return " ".join(line.partition("#")[0] for line in lines).split().count(word)


def test_an_error_past_the_end_is_at_the_last_word(tmp_path):
    words = Words(source_of(tmp_path, "states: 2\nactions:\n"))
    with refused(FormatError) as caught:
        words.fail(99, "more was expected")
    assert (caught.value.line, caught.value.column) == (2, 8)


@pytest.mark.parametrize(
    ("word", "value"), [("1", 1.0), ("-.5e2", -50.0), ("inf", float("inf")), ("1_0", None), ("x", None), ("", None)]
)
def test_numbers(word, value):
    assert number(word) == value


@pytest.mark.parametrize(
    ("path", "suffix"), [("a.POMDP", ".pomdp"), ("a.pomdp.gz", ".pomdp"), ("a.b.GZ", ".b"), ("a.gz", ""), ("a", "")]
)
def test_suffixes(path, suffix):
    assert suffixes(path) == suffix


def test_a_compressed_file_is_read_up_to_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("mdm.formats.source._LARGEST", 1_000_000)
    path = tmp_path / "bomb.pomdp.gz"
    path.write_bytes(gzip.compress(b" " * 1_000_001))
    with refused(FormatError):
        load_model(path)


def test_a_pipe_is_not_waited_on(tmp_path):
    for name in ("model.pomdp", "model.npz", "policy.vf"):
        os.mkfifo(tmp_path / name)
        with refused(FormatError):
            load_policy(tmp_path / name) if name.endswith("vf") else load_model(tmp_path / name)
