"""Policies that are kept in files: what their solver proves today."""

from __future__ import annotations

import warnings

import pytest
from solved import FOLDER, facts, solved

from mdm import ModelWarning, load_model, problems, solve
from mdm.models.digest import digest


@pytest.mark.slow
@pytest.mark.parametrize("name", facts())
def test_each_is_solved_to_the_same_bounds(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        model = load_model(FOLDER / f"{name}.npz")
    assert digest(model) == name
    kept = solved(model, **facts()[name]["options"])
    found = solve(model, **facts()[name]["options"])
    assert found.lower <= kept.upper + 1e-9
    assert kept.lower <= found.upper + 1e-9
    assert kept.policy.value(model.initial_belief) == pytest.approx(kept.lower, abs=1e-9)


def test_files_and_facts_belong_together():
    files = {path.name for path in FOLDER.iterdir()} - {"solved.json"}
    assert files == {f"{name}{suffix}" for name in facts() for suffix in (".npz", ".policy")}


def test_a_model_that_was_not_solved_is_told_with_the_way_out():
    with pytest.raises(AssertionError, match=r"solved with \{'gap': 0.5\}: write it by MDM_SOLVED=write"):
        solved(problems.tiger(discount=0.75), gap=0.5)
