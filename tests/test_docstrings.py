"""The examples in docstrings run, and give the values that their comments say."""

from __future__ import annotations

import ast
import importlib
import inspect
import io
import textwrap
import tokenize

import numpy as np
import pytest
from places import EXAMPLES

import mdm

PACKAGES = ("beliefs", "models", "policies", "simulation", "team")
NAMES = [f"{package}.{name}" for package in PACKAGES for name in importlib.import_module(f"mdm.{package}").__all__]
NAMES += ["Controller", "Formula", "P", "System", "load_model", "load_policy", "parse"]
WITHOUT = {  # protocols and results, which users do not make; and what a named class' example shows
    "beliefs.Drawn",
    "beliefs.DrawnInformation",
    "beliefs.KnownState",
    "models.FactoredMDP",
    "models.FactoredPOMDP",
    "models.Node",
    "models.Potential",
    "models.Table",
    "models.Tree",
    "policies.Deliberating",
    "policies.PACKABLE",
    "policies.Scores",
    "policies.mismatch",
    "team.Confirmation",
    "simulation.CommunicationEvaluation",
    "simulation.Comparison",
    "simulation.Evaluation",
    "simulation.ReachingEvaluation",
    "simulation.WorkerWarning",
    "team.Agent",
    "team.Committed",
    "team.Experience",
    "team.Member",
    "team.MemberStatistics",
    "team.RecollectionStatistics",
    "team.SharedHistory",
    "team.TeamOptions",
    "team.Teammates",
}


def example(name):
    """Return the code of a public name's example; None where it has none."""
    found = mdm
    for part in name.split("."):
        found = getattr(found, part)
    _, mark, rest = (inspect.getdoc(found) or "").partition("Example::\n")
    lines = rest.splitlines()
    end = next((index for index, line in enumerate(lines) if line and not line.startswith("    ")), len(lines))
    return textwrap.dedent("\n".join(lines[:end])).strip() if mark else None


def test_public_classes_and_functions_have_examples():
    assert {name for name in NAMES if example(name) is None} == WITHOUT


@pytest.mark.parametrize("name", [name for name in NAMES if example(name) is not None])
def test_examples_say_what_they_do(name, monkeypatch):
    monkeypatch.chdir(EXAMPLES)
    code = example(name)
    said = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(code).readline)
        if token.type == tokenize.COMMENT
    }
    scope = {"mdm": mdm, "np": np}
    for statement in ast.parse(code).body:
        if isinstance(statement, ast.Expr) and (words := said.get(statement.end_lineno, "the ")):
            value = eval(compile(ast.Expression(statement.value), name, "eval"), scope)
            if not words.startswith("the "):  # a description
                assert_is(value, ast.literal_eval(words))
        else:
            exec(compile(ast.Module([statement], []), name, "exec"), scope)


def assert_is(value, said):
    if isinstance(said, tuple):
        for part, word in zip(value, said, strict=True):
            assert_is(part, word)
    elif isinstance(said, str):
        assert value == said
    else:
        assert np.asarray(value).tolist() == pytest.approx(said, rel=1e-3)
