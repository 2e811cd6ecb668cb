"""What is written is what the original tools take: read by readers as strict as theirs, number by number."""

from __future__ import annotations

import warnings
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from random_models import NAMES, factored_models, flat_models
from strict import cassandra, madp, pgmx, pomdpx
from strict.numbers import assert_same_numbers

from mdm import ModelError, problems, save_model
from mdm.errors import ModelWarning

READERS = {".dpomdp": madp.read, ".pgmx": pgmx.read, ".pomdpx": pomdpx.read}
SMALLER = {
    "rock_sample": lambda: problems.rock_sample(3, 2),
    "field_vision_rock_sample": lambda: problems.field_vision_rock_sample(3, 2),
}
LARGEST = 20_000_000


def problem(name):
    return SMALLER.get(name, getattr(problems, name))()


def written(model, folder):
    """Write a model in every format that can hold it; return what strict readers find in the files."""
    found = {}
    flat = partial(cassandra.read, mdp=model.kind == "MDP")
    for suffix, read in {".pomdp": flat, ".mdp": flat, **READERS}.items():
        path = folder / f"model{suffix}"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)
            try:
                # What a tool has no place for is told.
                warnings.filterwarnings("error", "(?s).*(MADP reads|MADP does not read|SARSOP does not)", ModelWarning)
                save_model(model, path)
            except (ModelError, ModelWarning):
                continue
        found[suffix] = read(path)
    return found


def assert_all_the_same(model, folder):
    for suffix, numbers in written(model, folder).items():
        flat = model.kind == "MDP" and suffix in {".mdp", ".pomdp"}
        if flat and not np.allclose(numbers.start, model.initial_belief, rtol=0, atol=1e-12):
            assert model.initial_belief.max() < 1  # several states: an MDP's start is one, or not given
            assert_same_numbers(numbers._replace(start=model.initial_belief), model)
        else:
            assert_same_numbers(numbers, model)


@pytest.mark.parametrize("name", problems.__all__)
def test_standard_problems(name, tmp_path):
    model = problem(name)
    if len(model.state_space) ** 2 * len(model.action_space) > LARGEST / 10:
        pytest.skip("too large for readers of dense arrays")
    assert_all_the_same(model, tmp_path)


@given(model=flat_models(events=True))
def test_flat_models(model, tmp_path_factory):
    assert_all_the_same(model, tmp_path_factory.mktemp("strict"))


@given(model=factored_models(events=True))
def test_factored_models(model, tmp_path_factory):
    assert_all_the_same(model, tmp_path_factory.mktemp("strict"))


@given(model=flat_models(names=NAMES))
def test_odd_names(model, tmp_path_factory):
    assert_all_the_same(model, tmp_path_factory.mktemp("strict"))
