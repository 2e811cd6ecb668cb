"""What all problems have in common."""

from __future__ import annotations

import inspect
import subprocess
import sys

import numpy as np
import pytest

from mdm import ModelError, problems


@pytest.mark.parametrize("name", problems.__all__)
def test_every_problem_names_its_source_and_its_parameters(name):
    function = getattr(problems, name)
    assert function.__doc__.startswith("Return ")
    assert "Source: " in function.__doc__
    for parameter in inspect.signature(function).parameters.values():
        assert parameter.default is not inspect.Parameter.empty
        assert f"\n    {parameter.name}: " in inspect.getdoc(function)  # indented less than its source


@pytest.mark.parametrize("name", problems.__all__)
def test_every_problem_has_the_discount_that_is_asked_for(name):
    assert getattr(problems, name)(discount=0.625).discount == 0.625


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: problems.tiger("0.85"), "accuracy is a number, not '0.85'"),
        (lambda: problems.tiger(discount=True), "discount is a number, not True"),
        (lambda: problems.river_swim("6"), "length is a whole number, not '6'"),
        (lambda: problems.aloha(float("nan")), "levels is a whole number, not nan"),
        (lambda: problems.tag(field=None), "field is a text, not None"),
        (lambda: problems.rock_sample(positions=1), "positions are a list of pairs of whole numbers, not 1"),
        (lambda: problems.rock_sample(7, 1, positions=[(0, "a")]), "positions are a list of pairs"),
        (lambda: problems.rock_sample(start=0), "the start is a pair of whole numbers, not 0"),
        (lambda: problems.rock_sample(start=()), r"the start is a pair of whole numbers, not \(\)"),
        (lambda: problems.broadcast_channel(5), "give a probability of a message for each, not 5"),
    ],
)
def test_parameters_of_another_kind_are_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def test_numbers_of_numpy_are_plain_ones():
    assert len(problems.meeting(np.int64(2)).state_space) == len(problems.meeting(2).state_space)
    assert len(problems.fire_fighting(fire_levels=np.int64(2)).state_space) == len(
        problems.fire_fighting(fire_levels=2).state_space
    )
    assert problems.tiger(np.float32(0.5)).discount == 0.95


def test_the_package_is_loaded_when_it_is_asked_for_and_takes_models_alone():
    program = (
        "import sys, mdm; assert 'mdm.problems' not in sys.modules; import mdm.problems; "
        "print(sorted({name.split('.')[1] for name in sys.modules if name.startswith('mdm.')}), 'scipy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "['checks', 'errors', 'models', 'problems', 'texts'] False\n"
