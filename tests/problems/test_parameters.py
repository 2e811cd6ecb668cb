"""Parameters are of the kind that their annotations say, and are handed on as plain numbers and texts."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refused

from mdm import ModelError
from mdm.problems.parameters import checked


@checked
def problem(size: int, rate: float = 0.5, *, name: str = "x", places: list[int] | None = None):
    """Return what it was given."""
    return size, rate, name, places


@pytest.mark.parametrize(
    ("positional", "named", "found"),
    [
        ((3,), {}, (3, 0.5, "x", None)),
        ((np.int64(3), 1), {"name": "y"}, (3, 1.0, "y", None)),
        ((3,), {"rate": np.float32(0.25), "places": "anything"}, (3, 0.25, "x", "anything")),
    ],
)
def test_what_fits_is_handed_on_plain(positional, named, found):
    given = problem(*positional, **named)
    assert given == found
    assert list(map(type, given)) == list(map(type, found))


@pytest.mark.parametrize(
    ("positional", "named", "words"),
    [
        ((3.0,), {}, "size is a whole number, not 3.0"),
        ((True,), {}, "size is a whole number, not True"),
        ((3, "fast"), {}, "rate is a number, not 'fast'"),
        ((3,), {"rate": None}, "rate is a number, not None"),
        ((3,), {"name": 7}, "name is a text, not 7"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(positional, named, words):
    with pytest.raises(ModelError, match=words):
        problem(*positional, **named)


def test_it_still_reads_as_the_problem():
    assert problem.__name__ == "problem"
    assert problem.__doc__ == "Return what it was given."
    with refused(TypeError):
        problem(sise=3)
