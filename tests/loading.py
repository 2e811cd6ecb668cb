"""Files written for a test, and models of files whose numbers are known to be inexact."""

from __future__ import annotations

import warnings

import pytest

from mdm import FormatError, load_model
from mdm.errors import ModelWarning


def load(path, **options):
    """Return a file's model without warnings of its numbers; a factored one is flattened."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(path, **options)
        model.flatten()
        return model


def written(folder, text, name="x.policy"):
    """Return the path of a file with a text."""
    path = folder / name
    path.write_text(text)
    return path


def assert_refused_where_it_breaks(path, expected):
    """Have a broken file refused: at its line, where one is expected, and in the words that are."""
    with pytest.raises(FormatError) as caught:
        load(path)
    assert caught.value.file == str(path)
    if expected["line"] is not None:
        assert caught.value.line == expected["line"]
    for words in expected["message_mentions"]:
        assert words in str(caught.value)
