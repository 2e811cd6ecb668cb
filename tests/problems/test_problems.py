"""What all problems have in common."""

from __future__ import annotations

import inspect
import subprocess
import sys

import pytest

from mdm import problems


@pytest.mark.parametrize("name", problems.__all__)
def test_every_problem_names_its_source_and_its_parameters(name):
    function = getattr(problems, name)
    assert function.__doc__.startswith("Return ")
    assert "Source: " in function.__doc__
    for parameter in inspect.signature(function).parameters.values():
        assert parameter.default is not inspect.Parameter.empty
        assert f"        {parameter.name}: " in function.__doc__


@pytest.mark.parametrize("name", problems.__all__)
def test_every_problem_has_the_discount_that_is_asked_for(name):
    assert getattr(problems, name)(discount=0.625).discount == 0.625


def test_the_package_is_loaded_when_it_is_asked_for_and_takes_models_alone():
    program = (
        "import sys, mdm; assert 'mdm.problems' not in sys.modules; import mdm.problems; "
        "print(sorted({name.split('.')[1] for name in sys.modules if name.startswith('mdm.')}), 'scipy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "['errors', 'models', 'problems'] False\n"
