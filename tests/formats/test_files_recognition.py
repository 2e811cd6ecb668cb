"""A text is told for a model or a policy by how it begins."""

from __future__ import annotations

import gzip
import re

import pytest
from places import DATA, EXAMPLES
from sentences import refused

from mdm import FormatError, load_model, load_policy
from mdm.formats.files import beginning, holds_policy, is_policy

MODELS = sorted((DATA / "models").iterdir())
POLICIES = sorted((DATA / "policies").iterdir())


@pytest.mark.parametrize("path", [*MODELS, EXAMPLES / "tiger.pomdp"], ids=lambda path: path.name)
def test_a_model_under_the_name_of_a_policy(tmp_path, path):
    for name, data in (("x.vf", path.read_bytes()), ("x.policy", gzip.compress(path.read_bytes()))):
        (tmp_path / name).write_bytes(data)
        with refused(FormatError):
            load_policy(tmp_path / name)


@pytest.mark.parametrize("path", POLICIES, ids=lambda path: path.name)
def test_a_policy_under_the_name_of_a_model(tmp_path, path):
    for name, data in (("x.pomdp", path.read_bytes()), ("x.pgmx", gzip.compress(path.read_bytes()))):
        (tmp_path / name).write_bytes(data)
        with refused(FormatError):
            load_model(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("# 3 states\n\n  discount : 0.9", False),
        ("states: 3", False),
        ("# discount: 0.9\n 0\n1 2", True),
        ("-.5 1", True),
        ("<!-- a --><x:POMDPX>", False),
        ("<?xml version='1.0'?>", None),
        ("hello: world", None),
        ("statesman: 3", None),
        ("# states: 3", None),
        ("", None),
    ],
)
def test_what_a_beginning_tells(text, told):
    assert holds_policy(text) is told


def test_what_cannot_be_read_tells_nothing(tmp_path):
    (tmp_path / "cut.gz").write_bytes(b"\x1f\x8b damaged")
    for path in (tmp_path, tmp_path / "nothing", tmp_path / "cut.gz"):
        assert beginning(path) == ""


OTHERS = {
    "coffee.spudd": ("(variables (huc yes no))\naction go\n", "a model of SPUDD or Symbolic Perseus"),
    "coffee.dat": (
        "// a comment of SPUDD\n# another\n (variables (huc yes no))",
        "begins with '// a comment of SPUDD'",
    ),
    "coffee.pomdp": ("# a comment\n(variables (huc yes no))\n", "a model of SPUDD or Symbolic Perseus"),
    "a.pddl": ("(define (domain rooms))", "a model in PPDDL"),
    "a.rddl": ("domain rooms {\n}", "a model in RDDL"),
    "a.prism": ("mdp\n\nconst int N = 3;\nmodule robot\n s : [0..3];\nendmodule\n", "a model of PRISM"),
    "tree.policy": ('{"policy": [1, 2]}', "this is JSON"),
    "map.yaml": ("image: map.pgm\nresolution: 0.05\n", "a map of ROS"),
    "rules.txt": ("x1 -> left\nx2: right\n", "no model and no policy of a known form, it begins with 'x1 -> left'"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_neither_is_named_by_all_readers(tmp_path, name):
    text, told = OTHERS[name]
    (tmp_path / name).write_text(text)
    for read in (load_model, load_policy, is_policy):
        with pytest.raises(FormatError, match=re.escape(told)):
            read(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.txt", "0 1\n", True),
        ("a.alpha", "go\n1 2\n", True),
        ("a.pomdp", "stats: 3\nactions: 2\n", False),
        ("a.txt", "stats: 3\nactions: 2\n", False),
        ("a.pg", "", True),
        ("a.base", "2\n", False),
        ("a.policy", "states: 3\n", False),
    ],
)
def test_content_counts_more_than_the_suffix(tmp_path, name, text, told):
    (tmp_path / name).write_text(text)
    assert is_policy(tmp_path / name) is told
