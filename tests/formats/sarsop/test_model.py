"""POMDPX: the corpus, what the format allows, round trips, mutated files."""

from __future__ import annotations

import contextlib
import json
import random

import numpy as np
import pytest
from hypothesis import given, strategies as st
from loading import assert_refused_where_it_breaks, load
from mutation import mutated
from places import CORPUS, DATA, each
from random_models import dense
from sentences import refused

from mdm import FormatError, load_model
from mdm.errors import ModelWarning
from mdm.models import FactoredPOMDP


def entries(path):
    file = CORPUS / path
    return json.loads(file.read_text()) if file.is_file() else {}


def ours(expected):
    return sorted(file for file in expected if file.endswith(".pomdpx"))


MODELS = entries("expected.json")
EDGE = entries("edge/expected.json")
MALFORMED = entries("malformed/expected.json").get("cases", {})


@pytest.mark.foreign(".pomdpx models of AdaCompNUS/sarsop")
@pytest.mark.parametrize("file", each(ours(MODELS)))
def test_real_models(corpus, file):
    expected = MODELS[file]
    model = load(corpus / file)
    sizes = (len(model.state_space), len(model.action_space), len(model.observation_space))
    assert sizes == (expected["states"], expected["actions"], expected["observations"])
    assert model.discount == expected["discount"]
    seen = zip(model.state_space.factors, model.network.fully_observed, strict=True)
    variables = [
        {"name": name.removesuffix("_0"), "size": len(f), "fully_observed": s} for f, s in seen for name in [f.name]
    ]
    stated = [{**v, "name": v["name"].removesuffix("_1")} for v in expected["state_variables"]]
    assert variables == stated
    np.testing.assert_allclose(model.initial_belief, expected["initial_belief"], atol=1e-5)
    for action, state, following, value in expected["T_a_s_s1"]:
        assert dense(model.transition_matrix(action))[state, following] == pytest.approx(value, abs=1e-5)
    for action, following, symbol, value in expected["O_a_s1_o"]:
        assert dense(model.observation_matrix(action))[following, symbol] == pytest.approx(value, abs=1e-5)
    for action, state, value in expected["R_a_s"]:
        assert model.rewards[state, action] == pytest.approx(value, rel=1e-5, abs=1e-9)


@pytest.mark.foreign(".pomdpx and .pomdp models of AdaCompNUS/sarsop")
@pytest.mark.parametrize("name", each(["Tiger", "Hallway", "Hallway2"]))
def test_agrees_with_the_flat_file_of_the_same_model(corpus, name):
    folder = corpus / "models" / "sarsop"
    flat = next((file for file in folder.iterdir() if file.name.lower() == f"{name}.pomdp".lower()), None)
    if flat is None:
        pytest.skip(f"the corpus has no {name}.pomdp beside it")
    model, plain = load(folder / f"{name}.pomdpx"), load(flat)
    assert len(model.action_space) == len(plain.action_space)
    if len(model.state_space) != len(plain.state_space):
        pytest.skip("the two files number their states in other ways")
    np.testing.assert_allclose(model.rewards, plain.rewards, atol=1e-4)
    for action in range(len(plain.action_space)):
        for of in ("transition_matrix", "observation_matrix"):
            np.testing.assert_allclose(dense(getattr(model, of)(action)), dense(getattr(plain, of)(action)), atol=1e-5)


@pytest.mark.foreign("a collection of .pomdpx files with one quirk each")
@pytest.mark.parametrize("file", each(ours(EDGE)))
def test_quirks(corpus, file):
    expected = EDGE[file]["expect"]
    model = load(corpus / "edge" / file)
    seen = model.network.fully_observed
    assert [[f.name, len(f), s] for f, s in zip(model.state_space.factors, seen, strict=True)] == [
        [name, size, fully] for name, _, size, fully in expected["state_variables"]
    ]
    assert [factor.name for factor in model.action_space.factors] == expected["action_variables"]
    assert [factor.name for factor in model.observation_space.factors] == expected["observation_variables"]
    np.testing.assert_allclose(model.rewards.T, expected["R_action_state"], atol=1e-9)
    numbers = np.arange(1, len(model.state_space) + 1)
    assert (model.initial_belief * numbers).sum() == pytest.approx(expected["b0_checksum"])
    for action, state, following, value in expected["T_entries"]:
        assert dense(model.transition_matrix(action))[state, following] == pytest.approx(value, abs=1e-9)
    for action, following, symbol, value in expected["O_entries"]:
        assert dense(model.observation_matrix(action))[following, symbol] == pytest.approx(value, abs=1e-9)
    assert (
        sum(np.count_nonzero(dense(model.transition_matrix(a))) for a in range(len(model.action_space)))
        == expected["T_nonzero"]
    )


@pytest.mark.foreign("a collection of broken .pomdpx files")
@pytest.mark.parametrize("file", each(ours(MALFORMED)))
def test_broken_files_are_refused(corpus, file):
    assert_refused_where_it_breaks(corpus / "malformed" / file, MALFORMED[file])


DIAGRAM = (DATA / "models" / "lamp.pomdpx").read_text()


def test_diagrams_shortcuts_and_templates(tmp_path):
    (tmp_path / "d.pomdpx").write_text(DIAGRAM)
    model = load_model(tmp_path / "d.pomdpx")
    assert isinstance(model, FactoredPOMDP)
    assert model.network.fully_observed == (True, False)
    assert model.transition("wait", "on s1", "on s1") == 1
    assert model.transition("press", "off s0", "on s0") == 0.75
    assert model.transition("press", "on s2", "off s2") == 0.25
    assert model.observation("wait", "off s0", "dark") == 1
    assert model.observation("wait", "on s0", "dark") == 0.5
    assert [model.reward("press", f"on s{door}") for door in range(3)] == [0, 0, -7.5]
    assert model.reward("wait", "on s2") == 0
    np.testing.assert_allclose(model.initial_belief, [1 / 3] * 3 + [0] * 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('idref="mostly"/></Edge>\n<Edge val="on">', 'idref="no"/></Edge>\n<Edge val="on">'), "no template 'no'"),
        (('<SubDAGTemplate id="mostly">', '<SubDAGTemplate id="other">'), "no template 'mostly'"),
        (('<Edge val="on"><Terminal>0.75', '<Edge val="off"><Terminal>0.75'), "a second edge for 'off'"),
        (('<Edge val="on"><Terminal>0.75', '<Edge val="on"><Terminal>much'), "'much' is not a finite number"),
        (("<Terminal>0.75", "<Terminal>0.5"), "they sum to 0.75"),
        (
            ('var="lamp1"/></Edge>\n<Edge val="press">', 'var="act"/></Edge>\n<Edge val="press">'),
            "is not a state variable",
        ),
        (('type="uniform" var="door"', 'type="even" var="door"'), "type 'even'"),
        (("<Parent>act door</Parent>", "<Parent>act act</Parent>"), "lists a variable twice"),
        (('vnameCurr="door1"', 'vnameCurr="lamp1"'), "two variables are called 'lamp1'"),
        (("<NumValues>3</NumValues>", "<NumValues>-3</NumValues>"), "number of values from 1"),
        (("<Discount>0.9</Discount>", ""), "no <Discount>"),
        (("<Discount>0.9</Discount>", "<Discount>2</Discount>"), "at most 1, not '2'"),
        (("<Var>r</Var>", "<Var>q</Var>"), "no RewardVar 'q'"),
        (("<Var>door1</Var>", "<Var>lamp1</Var>"), "has a distribution already"),
        (('fullyObs="true"', 'fullyObs="perhaps"'), "true or false"),
        (("<Instance>- -</Instance>", "<Instance>s0 -</Instance>"), "'identity' needs two"),
        (("<pomdpx ", "<pomdp "), "XML|was expected"),
    ],
)
def test_wrong_files_are_refused_with_the_place(tmp_path, change, message):
    assert change[0] in DIAGRAM
    (tmp_path / "d.pomdpx").write_text(DIAGRAM.replace(*change, 1))
    with pytest.raises(FormatError, match=message) as caught:
        load_model(tmp_path / "d.pomdpx")
    assert "d.pomdpx" in str(caught.value)


def test_a_model_without_observations_is_an_mdp_where_all_is_seen(tmp_path):
    text = DIAGRAM[: DIAGRAM.index("<ObsFunction>")] + DIAGRAM[DIAGRAM.index("<RewardFunction>") :]
    text = text.replace('<ObsVar vname="eye"><ValueEnum>dark light</ValueEnum></ObsVar>\n', "")
    (tmp_path / "hidden.pomdpx").write_text(text)
    model = load_model(tmp_path / "hidden.pomdpx")
    assert (model.kind, len(model.observation_space)) == ("POMDP", 1)
    (tmp_path / "seen.pomdpx").write_text(text.replace('vnameCurr="door1"', 'vnameCurr="door1" fullyObs="true"'))
    assert load_model(tmp_path / "seen.pomdpx").kind == "MDP"


def test_a_missing_start_is_uniform_with_a_warning(tmp_path):
    begin, end = DIAGRAM.index("<InitialStateBelief>"), DIAGRAM.index("<StateTransitionFunction>")
    (tmp_path / "d.pomdpx").write_text(DIAGRAM[:begin] + DIAGRAM[end:])
    with pytest.warns(ModelWarning, match="no initial belief"):
        model = load_model(tmp_path / "d.pomdpx")
    np.testing.assert_allclose(model.initial_belief, np.full(6, 1 / 6))


@given(seed=st.integers(0, 2**32 - 1))
def test_mutated_files_make_a_model_or_an_error(seed, tmp_path_factory):
    pieces = ["<", "-", "*", "1e999", "nan", "&x;", "é", '"', "</Node>"]
    text = mutated(DIAGRAM, random.Random(seed), pieces)
    path = tmp_path_factory.mktemp("mutated") / "m.pomdpx"
    path.write_text(text)
    with contextlib.suppress(FormatError):
        load(path)


REWARD = DIAGRAM[DIAGRAM.index("<Func>") : DIAGRAM.index("</Func>") + len("</Func>")]


@pytest.mark.parametrize("section", ["InitialStateBelief", "StateTransitionFunction", "ObsFunction", None])
def test_a_function_of_rewards_is_refused_elsewhere(tmp_path, section):
    """Also where the section of rewards has one of its own."""
    place = f"</{section}>" if section else "<InitialStateBelief>"
    assert DIAGRAM.count(place) == 1
    (tmp_path / "d.pomdpx").write_text(DIAGRAM.replace(place, f"{REWARD}{place}"))
    with refused(FormatError):
        load_model(tmp_path / "d.pomdpx")
