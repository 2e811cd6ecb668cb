import warnings
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import Error, FormatError, ModelError, ModelWarning
from mdm.models import MDP, Factor, Space
from mdm.verification import Specification

NAMES = ["goal", "pit-1", "pit-2", "long hall", "not"]
MODEL = MDP(np.stack([np.eye(5)] * 2), np.zeros((5, 2)), discount=0.9, states=NAMES, actions=["Go", "Grab"])


def factored():
    position, door = Factor("position", ["hall", "stairs"]), Factor("door", ["open", "closed"])
    team = Space([Factor("ada", ["Go", "Wait"]), Factor("bob", ["Go", "Wait", "Lift"])])
    return MDP(np.stack([np.eye(4)] * 6), np.zeros((4, 6)), discount=0.9, states=Space([position, door]), actions=team)


def states(text, model=MODEL):
    mask = Specification.of(f"P(reach {text})", model).target
    assert (mask == mask[:, :1]).all()
    return [name for name, held in zip(model.state_space.names, mask[:, 0], strict=True) if held]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("goal", ["goal"]),
        ("pit-*", ["pit-1", "pit-2"]),
        ("pit-[2-9]", ["pit-2"]),
        ('"long hall"', ["long hall"]),
        ("'not'", ["not"]),
        ("3", ["long hall"]),
        ("state = pit-?", ["pit-1", "pit-2"]),
        ("state=goal", ["goal"]),
        ("not pit-* and not goal", ["long hall", "not"]),
        ("goal or pit-1 and pit-2", ["goal"]),
        ("(goal or pit-1) and not(pit-1)", ["goal"]),
        ("not not goal", ["goal"]),
    ],
)
def test_a_formula_says_which_states(text, wanted):
    assert states(text) == wanted


def test_factors_and_their_values():
    model = factored()
    assert states("position = stairs", model) == ["stairs open", "stairs closed"]
    assert states("position = stairs and not door = open", model) == ["stairs closed"]
    assert states('"hall open"', model) == ["hall open"]


def test_actions_and_those_of_an_agent():
    mask = Specification.of("P(reach goal and action = G*)", MODEL).target
    assert mask[0].tolist() == [True, True, False]
    assert not mask[1:].any()
    mask = Specification.of("P(reach not action = Grab)", MODEL).target
    assert mask[0].tolist() == [True, False, True]  # behind its end a plan does not grab
    mask = Specification.of("P(reach bob = Lift)", factored()).target
    assert mask[0].tolist() == [False, False, True] * 2 + [False]


def test_kinds_of_specifications():
    asked = Specification.of("P( reach pit-* before goal within 50 )", MODEL)
    assert (asked.kind, asked.within, asked.always) == ("P", 50, False)
    assert asked.before[:, 0].tolist() == [True, False, False, False, False]
    assert Specification.of("P(always not pit-*)", MODEL).always
    assert Specification.of("P(always not pit-*)", MODEL).target[:, 0].tolist() == [False, True, True, False, False]
    assert Specification.of("E(steps until goal)", MODEL).kind == "E"
    assert Specification.of("S(goal)", MODEL).kind == "S"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "Q(reach goal)",
        "P reach goal",
        "P(rech goal)",
        "P(reach)",
        "P(reach goal",
        "P(reach goal) twice",
        "P(reach goal pit-1)",
        "P(reach goal within soon)",
        "P(reach goal within 5 within 6)",
        "P(reach goal before goal within 5 before goal)",
        "P(reach goal and)",
        "P(reach (goal)",
        'P(reach "goal)',
        "P(reach state = )",
        "E(reach goal)",
        "E(steps goal)",
        "P(reach " + "(" * 101 + "goal" + ")" * 101 + ")",
        "P(reach " + "not " * 101 + "goal)",
    ],
)
def test_what_does_not_parse_is_refused_with_its_place(text):
    with refused(FormatError):
        Specification.of(text, MODEL)


@pytest.mark.parametrize(
    "text",
    [
        "P(reach gaol)",
        "P(reach 'pit-*')",
        "P(reach positon = stairs)",
        "P(reach position = stiars)",
        "P(reach action = Lfit)",
        "P(reach bob = Lfit)",
    ],
)
def test_unknown_names_are_refused_with_the_nearest(text):
    with refused(ModelError):
        Specification.of(text, MODEL if "pos" not in text and "bob" not in text else factored())


def test_a_formula_that_holds_nowhere_is_told():
    with pytest.warns(ModelWarning, match=r"nothing in the model satisfies hole-\* or pit-9\*$"):
        Specification.of("P(reach hole-* or pit-9* before goal)", MODEL)


@given(st.text(alphabet="PES(reach goal=within*'\"not.0 )", max_size=40))
def test_any_text_is_taken_or_refused(text):
    with suppress(Error), warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        Specification.of(text, MODEL)
