"""Random models for property tests, flat and factored, and what it means that two are the same."""

from __future__ import annotations

import warnings

import numpy as np
from hypothesis import strategies as st

from mdm.errors import ModelWarning
from mdm.models import (
    MDP,
    POMDP,
    Factor,
    FactoredMDP,
    FactoredPOMDP,
    Node,
    Space,
    Table,
    Tree,
    TwoSliceNetwork,
)

ODD = [
    "a b",
    'say "no"',
    "it's",
    "<&>",
    "x:y",
    "#1",
    "*",
    "-",
    "",
    "T",
    "start",
    "uniform",
    "5",
    "0",
    "é",
    "\t",
    "null",
]
NAMES = st.one_of(st.sampled_from(ODD), st.text(st.characters(codec="utf-8", exclude_characters="\0\r"), max_size=4))
PLAIN = st.sampled_from(
    [
        first + rest
        for first in "AbcDeFxyZT"
        for rest in ("", "1", "a", "B2", "_", "-", "_left", "-x-0", "oom3", "OrNot", "e5", "rue", "ull1", "-_9z")
        if first + rest != "T"
    ]
)
"""Names that every format can write as they are: letters, digits, hyphens and underscores; none is a keyword."""


@st.composite
def spaces(draw, names=PLAIN, most=2, largest=3, smallest=1):
    factors = draw(st.integers(1, most))
    titles = draw(st.lists(PLAIN, min_size=factors, max_size=factors, unique=True))
    return Space(
        Factor(title, draw(st.lists(names, min_size=smallest, max_size=largest, unique=True))) for title in titles
    )


def distributions(random, *shape):
    """Return random distributions along the last axis, with zeros and now and then all in one place."""
    array = random.random(shape) * (random.random(shape) < 0.7)
    places = random.integers(shape[-1], size=shape[:-1])
    array[(*np.indices(shape[:-1]), places)] += 0.1
    sure = random.random(shape[:-1]) < 0.2
    array[sure] = np.eye(shape[-1])[places[sure]]
    return array / array.sum(axis=-1, keepdims=True)


def rounded(random, *shape):
    """Return random rewards, some of them alike."""
    return np.where(random.random(shape) < 0.5, random.normal(size=shape) * 10, random.integers(-3, 3, size=shape))


@st.composite
def flat_models(draw, names=PLAIN, kinds=("MDP", "POMDP"), joint=True, events=False, finer=True, smallest=1):
    """Return a random MDP or POMDP; with events some POMDPs observe transitions."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    states = draw(spaces(names, 2 if joint else 1, smallest=smallest))
    actions = draw(spaces(names, 2 if joint else 1))
    size, count = len(states), len(actions)
    kind = draw(st.sampled_from(kinds))
    transitions = distributions(random, count, size, size)
    form = draw(st.integers(0, 3 if finer else 0))
    shapes = {0: (size, count), 1: (size,), 2: (count, size, size), 3: (count, size, size)}
    options = {
        "discount": draw(st.sampled_from([1.0, 0.9, 0.95, 1 / 3])),
        "states": states,
        "actions": actions,
        "initial_belief": distributions(random, size),
        "sparse": draw(st.booleans()),
    }
    if kind == "MDP":
        return MDP(transitions, rounded(random, *shapes[form]), **options)
    observations = draw(spaces(names, 2 if joint else 1))
    width = len(observations)
    if form == 3:
        shapes[3] = (count, size, size, width)
    if events and draw(st.booleans()):
        told = np.moveaxis(distributions(random, count, size, size, width), -1, 1)
        if draw(st.booleans()):
            told *= 0.9
        options["event_observations"] = True
    else:
        told = distributions(random, count, size, width)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # events may leave a part to no observation
        return POMDP(transitions, told, rounded(random, *shapes[form]), observation_names=observations, **options)


@st.composite
def networks(draw, names=PLAIN, events=False, smallest=1):
    """Return a random two-slice network, of tables and trees."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    states = draw(spaces(names, 3, smallest=smallest))
    actions = draw(spaces(names, 2, smallest=smallest))
    observations = draw(st.none() | spaces(names, 2, smallest=smallest))
    spaces_of = {"state": states, "next_state": states, "action": actions, "observation": observations}

    def size(node):
        return len(spaces_of[node.role].factors[node.place])

    def nodes(role):
        return [Node(role, place) for place in range(len(spaces_of[role].factors))]

    def table(parents, child):
        shape = [size(node) for node in parents]
        if child is None:
            return Table(parents, rounded(random, *shape) if shape else float(random.integers(-3, 3)))
        values = distributions(random, *shape, size(child))
        scope = [*parents, child]
        order = draw(st.permutations(range(len(scope))))
        return Table([scope[axis] for axis in order], values.transpose(order))

    def potential(parents, child):
        chosen = draw(st.lists(st.sampled_from(parents), max_size=3, unique=True)) if parents else []
        if not chosen or draw(st.booleans()):
            return table(chosen, child)
        top, rest = chosen[0], chosen[1:]
        branches = [table(draw(st.sampled_from([rest, []])), child) for _ in range(draw(st.integers(1, 2)))]
        if child is None and draw(st.booleans()):
            branches.append(Tree(top, [0] * size(top), [branches[0]]))
        choice = draw(st.lists(st.integers(0, len(branches) - 1), min_size=size(top), max_size=size(top)))
        return Tree(top, choice, branches)

    def conditionals(role, before):
        known, result = list(before), []
        for node in nodes(role):
            result.append(potential(known, node))
            known.append(node)
        return result

    now = [*nodes("state"), *nodes("action")]
    after = [*now, *nodes("next_state")]
    everything = after
    observation = []
    if observations is not None:
        seen = after if events and draw(st.booleans()) else [*nodes("action"), *nodes("next_state")]
        observation = conditionals("observation", seen)
        everything = [*after, *nodes("observation")]
    return TwoSliceNetwork(
        states,
        actions,
        observations,
        initial=conditionals("state", []),
        transitions=conditionals("next_state", now),
        observation=observation,
        utilities=[potential(draw(st.sampled_from([now, everything])), None) for _ in range(draw(st.integers(0, 2)))],
        fully_observed=draw(st.lists(st.booleans(), min_size=len(states.factors), max_size=len(states.factors))),
    )


@st.composite
def factored_models(draw, names=PLAIN, events=False, smallest=1):
    """Return a random factored model."""
    network = draw(networks(names, events, smallest))
    kind = FactoredMDP if network.observations is None else FactoredPOMDP
    return kind(network, discount=draw(st.sampled_from([1.0, 0.9, 1 / 3])), sparse=draw(st.booleans()))


def dense(matrix):
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def without_detection(model, action, missed=None, *, tells_all=False):
    """Return P(s', nothing is detected | s, a), S x S'.

    That is a false negative, and what events leave to no observation, unless an agent is told of each time step.
    """
    joints = [dense(model.joint_matrix(action, o)) for o in range(len(model.observation_space))]
    if tells_all:
        return np.zeros(joints[0].shape)
    steps = np.zeros(joints[0].shape) if missed is None else joints[missed]
    left = dense(model.transition_matrix(action)) - sum(joints)
    left = np.where(left > 1e-9, left, 0)
    return steps if left.sum(axis=1).max() <= 1e-5 else steps + left  # so little is taken for rounding


def leading_to_detection(steps):
    """Return steps without a detection, without the rows of states from which nothing is ever detected."""
    leads = steps.sum(axis=1) < 1 - 1e-9
    for _ in steps:
        leads = leads | (steps @ leads > 0)
    return steps * leads[:, None]


def assert_same(model, other, *, within=1e-12, named=True, finer=False):
    """Compare two models: sizes and numbers, and names and rewards of outcomes where they are to be the same."""
    assert model.kind == other.kind
    pairs = [(model.state_space, other.state_space), (model.action_space, other.action_space)]
    if model.kind == "POMDP":
        pairs.append((model.observation_space, other.observation_space))
    for space, again in pairs:
        assert len(space) == len(again)
        if named:
            assert [factor.names for factor in space.factors] == [factor.names for factor in again.factors]
    assert model.discount == other.discount
    options = {"atol": within, "rtol": within}
    np.testing.assert_allclose(model.initial_belief, other.initial_belief, **options)
    np.testing.assert_allclose(model.rewards, other.rewards, rtol=max(within, 1e-11), atol=max(within, 1e-11))
    size, count = len(model.state_space), len(model.action_space)
    for action in range(count):
        transition = dense(model.transition_matrix(action))
        np.testing.assert_allclose(transition, dense(other.transition_matrix(action)), **options)
        if model.kind == "MDP":
            continue
        assert model.event_observations == other.event_observations
        if model.event_observations:
            possible = transition > 0
            for o in range(len(model.observation_space)):
                told, again = (dense(each.event_matrix(action, o))[possible] for each in (model, other))
                np.testing.assert_allclose(told, again, **options)
        else:
            told, again = (dense(each.observation_matrix(action)) for each in (model, other))
            np.testing.assert_allclose(told, again, **options)
    if finer:
        width = range(len(model.observation_space)) if model.kind == "POMDP" else [None]
        for a, s, t in np.ndindex(count, size, size):
            for o in width:
                assert abs(model.reward(a, s, t, o) - other.reward(a, s, t, o)) <= 1e-11 * (
                    1 + abs(model.reward(a, s, t, o))
                )


def random_mdp(seed, states=4, actions=2):
    random = np.random.default_rng(seed)
    transitions = random.dirichlet(np.ones(states) * 0.5, size=(actions, states))
    return MDP(transitions, random.normal(size=(states, actions)), discount=0.8), random.integers(actions, size=states)
