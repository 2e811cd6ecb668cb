"""uBLAS's printed arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given, strategies as st
from loading import written
from random_policies import floats
from sentences import refused

from mdm import FormatError
from mdm.formats import files as policies, mdm1 as ublas


def printed(array):
    """Print an array as uBLAS does."""
    if array.ndim == 1:
        return f"[{len(array)}]({','.join(map(repr, array.tolist()))})"
    rows = ",".join(f"({','.join(map(repr, row))})" for row in array.tolist())
    return f"[{array.shape[0]},{array.shape[1]}]({rows})"


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(0, 4), st.sampled_from(["", " ", "\n"]))
def test_what_is_printed_is_read(tmp_path_factory, seed, rows, columns, blank):
    random = np.random.default_rng(seed)
    array = random.normal(size=(rows, columns) if columns else rows)
    text = printed(array).replace(",", f"{blank},{blank}").replace("(", f"({blank}").replace("]", f"]{blank}")
    np.testing.assert_array_equal(ublas.read(written(tmp_path_factory.mktemp("u"), text)), array)


@given(st.text(alphabet="[](),0123.-e \n", max_size=30))
def test_any_text_gives_an_array_or_a_format_error(tmp_path_factory, text):
    path = written(tmp_path_factory.mktemp("u"), text)
    try:
        assert ublas.read(path).size > 0
    except FormatError as error:
        assert str(path) in str(error)


def test_ublas_has_no_more_than_two_dimensions(tmp_path):
    with refused(ValueError):
        ublas.write(np.zeros((1, 1, 1)), Path(tmp_path / "x"))


def test_a_matrix_of_rewards_comes_back(tmp_path):
    values = floats(np.random.default_rng(1), 4, 3)
    ublas.write(values, tmp_path / "r")
    np.testing.assert_array_equal(policies.load_rewards(tmp_path / "r"), values)
