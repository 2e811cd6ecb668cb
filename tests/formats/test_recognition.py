"""A text is told for a model or a policy by how it begins."""

from __future__ import annotations

import gzip

import pytest
from places import DATA, EXAMPLES
from sentences import refused

from mdm import FormatError, load_model, load_policy
from mdm.formats.recognition import beginning, holds_policy

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
