"""The golden files of sentences: of tests that there are, and compared as a whole."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest
import sentences
from sentences import refused

from mdm import ConfigError


@cache
def functions(path):
    """Return the names of a file's tests."""
    return {node.name for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.FunctionDef)}


def test_every_sentence_is_of_a_test_that_there_is():
    files = sorted(sentences.TESTS.rglob(sentences.NAME))
    assert len(files) > 30
    for file in files:
        for test in sentences.read(file):
            path, _, name = test.partition("::")
            assert name.partition("[")[0] in functions(sentences.TESTS.parent / path), f"{file}: {test}: make sentences"


def test_a_file_holds_what_was_written(tmp_path, monkeypatch):
    monkeypatch.setattr(sentences, "TESTS", tmp_path / "tests")
    path = tmp_path / "tests" / sentences.NAME
    path.parent.mkdir()
    told = {
        "tests/test_a.py::test_x[a b]": ["Error: one\n  two", "Error: "],
        "tests/test_b.py::test_y": ["Error: \n\nx"],
    }
    sentences.write(path, told)
    assert sentences.read(path) == told
    sentences.write(path, {"tests/test_a.py::test_x[a b]": []})
    assert not path.exists()


@pytest.mark.parametrize(
    ("told", "words"), [("a wrong sentence", "sentence 0"), (None, "has more sentences"), ("kept, and more", "more")]
)
def test_a_sentence_that_differs_or_is_not_told_is_found(tmp_path, monkeypatch, told, words):
    monkeypatch.delenv(sentences.WRITING, raising=False)
    monkeypatch.setattr(sentences, "TESTS", tmp_path)
    kept = ["ConfigError: kept"] if told is None or "wrong" in told else ["ConfigError: kept, and more", "Error: two"]
    sentences.write(tmp_path / sentences.NAME, {f"{tmp_path.name}/test_a.py::test_x": kept})
    with pytest.raises(AssertionError, match=words), sentences.of(f"{tmp_path.name}/test_a.py::test_x"):
        if told is not None:
            with refused(ConfigError):
                raise ConfigError(told)


def test_places_and_addresses_are_the_same_everywhere(tmp_path):
    text = f"{tmp_path / 'a.toml'}: {sentences.TESTS.parent / 'mdm'}: <object at 0x7f3a55e0b2c0>"
    assert sentences.same_everywhere(text) == "TEMPORARY/a.toml: CHECKOUT/mdm: <object at 0x...>"
    assert Path(sentences.golden_file("tests/config/test_share.py::test_x")).parent.name == "config"
