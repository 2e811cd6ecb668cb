"""What is written is what the original tools take: read by readers as strict as theirs, number by number."""

from __future__ import annotations

import math
import warnings
from functools import partial
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from loading import load, written as written_text
from places import foreign
from random_models import NAMES, factored_models, flat_models
from random_policies import alpha, masked, mixed, q_values
from strict import cassandra, madp, pgmx, policies, pomdpx
from strict.numbers import RefusedError, assert_same_numbers

from mdm import ModelError, problems, save_model, save_policy, solve
from mdm.errors import ModelWarning
from mdm.policies import FiniteStateController, JointController


def names_of(model):
    """Return the names of each agent's actions, and of its observations."""
    return [[list(factor.names) for factor in space.factors] for space in (model.action_space, model.observation_space)]


def tree(random, actions, observations, depth):
    """Return a random plan of so many decisions, whose nodes stand level by level."""
    levels = [observations**level for level in range(depth)]
    first = [sum(levels[:level]) for level in range(depth + 1)]
    successors = [
        [first[level + 1] + place * observations + o if level + 1 < depth else None for o in range(observations)]
        for level in range(depth)
        for place in range(levels[level])
    ]
    return FiniteStateController(random.integers(actions, size=len(successors)).tolist(), successors, actions)


READERS = {".dpomdp": madp.read, ".pgmx": pgmx.read, ".pomdpx": pomdpx.read}
SMALLER = {
    "rock_sample": lambda: problems.rock_sample(3, 2),
    "fire_fighting": lambda: problems.fire_fighting(houses=2),
    "machine_maintenance": lambda: problems.machine_maintenance(3),
    "meeting": lambda: problems.meeting(2),
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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fire_fighting", "machine_maintenance", "meeting"])
def test_standard_problems_in_their_usual_size(name, tmp_path):
    assert_all_the_same(getattr(problems, name)(), tmp_path)


@given(model=flat_models(events=True))
def test_flat_models(model, tmp_path_factory):
    assert_all_the_same(model, tmp_path_factory.mktemp("strict"))


@given(model=factored_models(events=True))
def test_factored_models(model, tmp_path_factory):
    assert_all_the_same(model, tmp_path_factory.mktemp("strict"))


@given(model=flat_models(names=NAMES))
def test_odd_names(model, tmp_path_factory):
    assert_all_the_same(model, tmp_path_factory.mktemp("strict"))


@pytest.mark.foreign("models of MADPToolbox/MADP, cassandra/pomdp-solve, AdaCompNUS/sarsop and others")
@pytest.mark.parametrize("file", foreign("edge/*/*.*pomdp*") + foreign("edge/mdp/*") + foreign("models/madp/d*.dpomdp"))
def test_files_of_others(corpus, file, tmp_path):
    assert_all_the_same(load(corpus / file), tmp_path)


@pytest.mark.parametrize("policy", [alpha(np.random.default_rng(seed), seed + 1) for seed in range(5)])
def test_alpha_vectors(policy, tmp_path):
    for suffix, read in ((".alpha", policies.alpha), (".vf", policies.value_function)):
        save_policy(policy, tmp_path / f"p{suffix}")
        actions, vectors = read(tmp_path / f"p{suffix}")
        assert actions == list(policy.actions)
        np.testing.assert_array_equal(vectors, policy.vectors)
    save_policy(policy, tmp_path / "p.policy")
    observed, found = policies.sarsop(tmp_path / "p.policy")
    assert observed == 1
    assert [action for action, _, _ in found] == list(policy.actions)
    np.testing.assert_array_equal([values for _, _, values in found], policy.vectors)


@pytest.mark.parametrize("policy", [mixed(np.random.default_rng(seed), seed + 1) for seed in range(5)])
def test_alpha_vectors_of_what_is_observed(policy, tmp_path):
    save_policy(policy, tmp_path / "p.policy")
    observed, found = policies.sarsop(tmp_path / "p.policy")
    expected = [
        (action, seen, vector.tolist())
        for seen, own in enumerate(policy.sets)
        if own is not None
        for action, vector in zip(own.actions, own.vectors, strict=True)
    ]
    assert (observed, found) == (len(policy.sets), expected)


@pytest.mark.parametrize(
    "model", [problems.rock_sample(2, 1), problems.rock_sample(3, 1), problems.field_vision_rock_sample(2, 2)]
)
def test_alpha_vectors_of_models_of_mixed_observability(model, tmp_path):
    """Observed values and hidden ones are told in the order of the file of the model: the last factor counts by one."""
    seen = model.revealed()
    policy = solve(seen, "sarsop", iterations=30, gap=0).policy
    save_model(model, tmp_path / "m.pomdpx")
    save_policy(policy, tmp_path / "p.policy", seen)
    factors = list(ET.parse(tmp_path / "m.pomdpx").getroot().iter("StateVar"))
    fully = [factor.get("fullyObs") == "true" for factor in factors]
    sizes = [int(factor[0].text) if factor[0].tag == "NumValues" else len(factor[0].text.split()) for factor in factors]
    observed, found = policies.sarsop(tmp_path / "p.policy")
    assert observed == math.prod(size for size, is_seen in zip(sizes, fully, strict=True) if is_seen)
    random = np.random.default_rng(1)
    for x in random.integers(observed, size=20):
        values = np.unravel_index(x, [size for size, is_seen in zip(sizes, fully, strict=True) if is_seen])
        hidden = random.dirichlet(np.ones(len(seen.state_space) // observed))
        belief = np.zeros(sizes)
        place = iter(values)
        belief[tuple(next(place) if is_seen else slice(None) for is_seen in fully)] = hidden.reshape(
            [size for size, is_seen in zip(sizes, fully, strict=True) if not is_seen]
        )
        told = [(float(np.dot(vector, hidden)), action) for action, own, vector in found if own == x]
        if told:
            assert policy.value(belief.ravel()) == pytest.approx(max(told)[0], rel=1e-12)


@pytest.mark.parametrize("policy", [masked(np.random.default_rng(seed), seed + 1) for seed in range(8)])
def test_planes(policy, tmp_path):
    save_policy(policy, tmp_path / "p.policy")
    found = policies.planes(tmp_path / "p.policy")
    assert found == list(zip(policy.actions, policy.vectors, strict=True))


@pytest.mark.parametrize("seed", range(5))
def test_joint_policies(seed, tmp_path):
    random = np.random.default_rng(seed)
    model = (problems.dec_tiger, problems.broadcast_channel, problems.box_pushing)[seed % 3]()
    names = names_of(model)
    trees = [tree(random, len(own), len(told), int(random.integers(1, 4))) for own, told in zip(*names, strict=True)]
    save_policy(JointController(trees), tmp_path / "p.policy", model)
    found = policies.joint(tmp_path / "p.policy", *names)
    for controller, told, own, words in zip(trees, found, *names, strict=True):
        assert len(told) == controller.num_nodes
        for history, action in told.items():
            node = controller.start
            for word in history:
                node = controller.successors[node][words.index(word)]
            assert own[controller.action_at(node)] == action


def test_joint_policies_of_the_solver(tmp_path):
    model = problems.dec_tiger()
    save_policy(solve(model, "jesp", horizon=3, seed=1).policy, tmp_path / "p.policy", model)
    names = names_of(model)
    assert [len(told) for told in policies.joint(tmp_path / "p.policy", *names)] == [7, 7]


@pytest.mark.parametrize("policy", [q_values(np.random.default_rng(seed), seed + 1) for seed in range(5)])
def test_tables(policy, tmp_path):
    path = tmp_path / "q.policy"
    save_policy(policy, path)
    np.testing.assert_array_equal(policies.ublas(path), policy.values)


def test_plans(tmp_path):
    plan = FiniteStateController([0, 2], [[1, None], [0, 1]], 3, values=[[1.0, 2.0], [0.5, 1e-7]])
    save_policy(plan, tmp_path / "plan.pg")
    assert policies.graph(tmp_path / "plan.pg", 2) == ([0, 2], [[1, None], [0, 1]])
    actions, vectors = policies.alpha(tmp_path / "plan.alpha")
    assert (actions, vectors.tolist()) == ([0, 2], [[1, 2], [0.5, 1e-7]])


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".pomdp", "states: 3\nactions: x\nobservations: p\nT: x\nidentity\nO: x\nuniform\nR: x : s0 : * : * 1\n"),
        (".pomdp", "states: a b\nactions: x\nobservations: p q\nT: x\nidentity\nO: x\nidentity\nR: * : * : * : * 1\n"),
        (".mdp", "states: a b\nactions: x\nstart: uniform\nT: x\nidentity\nR: x : * : * 1\n"),
    ],
)
def test_strict_readers_refuse_what_the_tools_refuse(tmp_path, suffix, text):
    path = written_text(tmp_path, f"discount: .9\nvalues: reward\n{text}", f"x{suffix}")
    with pytest.raises(RefusedError):
        cassandra.read(path, mdp=suffix == ".mdp")
