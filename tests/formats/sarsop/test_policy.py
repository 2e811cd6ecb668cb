"""The XML policies of APPL/SARSOP."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import places
import pytest
from sentences import refused

from mdm import FormatError
from mdm.formats import files as policies
from mdm.formats.sarsop import policy as sarsop_policy
from mdm.models import MDP, Factor, Space
from mdm.policies import AlphaVectors, MixedAlphaVectors

DATA = places.DATA / "policies"


def rooms(*fully_observed, sizes=(3, 2), num_actions=3):
    """Return a model with a network that says which of its state factors are observed."""
    space = Space(Factor(f"f{index}", size) for index, size in enumerate(sizes))
    model = MDP([np.eye(len(space))] * num_actions, np.zeros((len(space), num_actions)), discount=0.9, states=space)
    model.network = SimpleNamespace(fully_observed=fully_observed)
    return model


def test_vectors_for_each_observed_value():
    policy = policies.load_policy(DATA / "mixed.policy")
    assert isinstance(policy, MixedAlphaVectors)
    assert policy.states.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert [vectors.actions for vectors in policy.sets] == [[0, 1], [0, 2]]
    assert policy.sets[0].vectors.tolist() == [[9, -1, -1], [8.5, 7.75, 7.5]]
    assert policy.sets[1].vectors.tolist() == [[7.5, 0, 10], [1, 2, 3]]


def test_the_model_says_which_factors_are_observed():
    policy = policies.load_policy(DATA / "mixed.policy", rooms(False, True))
    assert policy.states.tolist() == [[0, 2, 4], [1, 3, 5]]
    belief = np.zeros(6)
    belief[5] = 1  # the second of the observed, the third of the hidden
    assert policy.value(belief) == 10
    assert policies.load_policy(DATA / "mixed.policy", rooms(True, False, sizes=(2, 3))).states.tolist() == [
        [0, 1, 2],
        [3, 4, 5],
    ]


def test_observed_factors_may_stand_between_hidden_ones():
    model = rooms(True, False, True, sizes=(2, 3, 4))
    states = sarsop_policy.layout(3, 8, model)
    for x in range(8):
        for y in range(3):
            assert states[x, y] == model.state_space.ravel((x // 4, y, x % 4))


def test_one_observed_value_is_no_mixed_observability(tmp_path):
    path = tmp_path / "x.policy"
    path.write_text('<Policy><AlphaVector vectorLength="2"><Vector action="1">1 2</Vector></AlphaVector></Policy>')
    policy = policies.load_policy(path)
    assert isinstance(policy, AlphaVectors)
    assert (policy.actions, policy.vectors.tolist()) == ([1], [[1, 2]])


class Words:
    """What SARSOP's program reads a policy with: tags, and numbers as words between blanks."""

    def __init__(self, text):
        self.text = text
        self.at = 0

    def tag(self):
        begin = self.text.find("<", self.at)
        if begin < 0:
            return "", {}
        end = self.text.index(">", begin)
        self.at = end + 1
        name, *rest = self.text[begin + 1 : end].split()
        return name, dict(re.fullmatch(r'([\w:]+)="([^"]*)"', word).groups() for word in rest if name[0] not in "?/")

    def word(self):
        match = re.compile(r"\s*(\S+)").match(self.text, self.at)
        self.at = match.end()
        assert len(match[1]) < 200  # its buffer
        return float(re.match(r"[-+.\deE]*", match[1])[0])  # as atof: up to what is no part of a number


def read_as_words(text):
    """Return what SARSOP's program finds in a policy: the observed value, action and numbers of each vector."""
    words = Words(text)
    assert [words.tag()[0], words.tag()[0]] == ["?xml", "Policy"]
    name, head = words.tag()
    assert name == "AlphaVector"
    found = []
    name, attributes = words.tag()
    while attributes:
        assert name == "Vector"
        numbers = [words.word() for _ in range(int(head["vectorLength"]))]
        found.append((int(attributes["obsValue"]), int(attributes["action"]), numbers))
        words.tag()  # the closing one, whatever stands there
        name, attributes = words.tag()
    return found


@pytest.mark.parametrize("suffix", [".policy", ".policyx"])
def test_the_program_of_the_format_finds_every_vector(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    vectors = np.random.default_rng(1).normal(size=(4, 3)) * 10.0 ** np.arange(-300, 100, 100)[:, None]
    policies.save_policy(AlphaVectors(vectors, [0, 0, 1, 2]), path)
    expected = [(0, action, row) for action, row in zip([0, 0, 1, 2], vectors.tolist(), strict=True)]
    assert read_as_words(path.read_text()) == expected
    policies.save_policy(policies.load_policy(DATA / "mixed.policy"), path)
    assert read_as_words(path.read_text()) == [
        (0, 0, [9, -1, -1]),
        (0, 1, [8.5, 7.75, 7.5]),
        (1, 0, [7.5, 0, 10]),
        (1, 2, [1, 2, 3]),
    ]


BODY = '<Policy><AlphaVector vectorLength="{0}" numObsValue="{1}" numVectors="1">{2}</AlphaVector></Policy>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<Plan/>", "a <Policy> was expected, not a <Plan>"),
        ("<pomdpx/>", "the file holds a model; a policy was expected"),
        ("<Policy/>", "no alpha vectors"),
        ("<Policy>", "well-formed"),
        ("<!DOCTYPE x><Policy/>", "DOCTYPE"),
        ('<Policy><Vector action="0">1</Vector></Policy>', "outside of an <AlphaVector>"),
        ("<Policy><AlphaVector/></Policy>", "needs the attribute 'vectorLength'"),
        ('<Policy><AlphaVector vectorLength="6"/><AlphaVector/></Policy>', "a second <AlphaVector>"),
        (BODY.format(6, 1, ""), "no alpha vectors"),
        (BODY.format(6, 1, '<Vector action="0">1 2 3 4 5 6</Vector>' * 2), "numVectors is 1, but 2"),
        (BODY.format("x", 1, ""), "vectorLength is 'x'"),
        (BODY.format(0, 1, ""), "from 1 to"),
        (BODY.format("9" * 30, 1, ""), "from 1 to"),
        (BODY.format(9999999, 9999999, ""), "9999999 x 9999999 states exceed the limit"),
        (BODY.format(6, 2, ""), "12 states (2 observed x 6 hidden), but the model has 6"),
        (BODY.format(2, 3, ""), "numObsValue is 3, but the model's fully observed factors have 2 values"),
        (BODY.format(6, 1, "<Vector>1</Vector>"), "needs the attribute 'action'"),
        (BODY.format(6, 1, '<Vector action="3">1</Vector>'), "from 0 to 2"),
        (BODY.format(6, 1, '<Vector action="-1">1</Vector>'), "action is '-1'"),
        (BODY.format(6, 1, '<Vector action="0" obsValue="1">1</Vector>'), "obsValue is '1'"),
        (BODY.format(6, 1, '<Vector action="0">1 2</Vector>'), "vectorLength is 6, but 2 numbers"),
        (BODY.format(6, 1, '<Vector action="0">1 2 3 4 5 x</Vector>'), "'x' is not a finite number"),
        (BODY.format(6, 1, '<Vector action="0">1 2 3 4 5 nan</Vector>'), "'nan' is not a finite number"),
        (BODY.format(6, 1, '<SparseVector action="0">0 1 2</SparseVector>'), "an odd number of words"),
        (
            BODY.format(6, 1, '<SparseVector action="0"><Entry>6 1</Entry></SparseVector>'),
            "'6' is not an index from 0 to 5",
        ),
        (BODY.format(6, 1, '<SparseVector action="0"><Entry>-1 1</Entry></SparseVector>'), "'-1' is not an index"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, text, words):
    path = tmp_path / "x.policy"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        policies.load_policy(path, rooms(False, True))
    assert words in str(caught.value)
    assert caught.value.file == str(path)


def test_a_small_file_cannot_ask_for_much_memory(tmp_path):
    path = tmp_path / "x.policy"
    path.write_text(BODY.format(9_999_999, 1, '<SparseVector action="0"/>' * 9))
    with refused(FormatError):
        policies.load_policy(path)
