"""Models whose actions are not all available in each state."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array
from sentences import refused

import mdm
from mdm.errors import ModelError
from mdm.models import MDP, POMDP, Durations, in_time
from mdm.models.digest import digest, first_difference, parts

NAN = float("nan")
HALL, DOOR = [True, True, False], [True, False, True]
NAMES = {"states": ["hall", "door"], "actions": ["wait", "walk", "open"]}
T = [
    [[1, 0], [0, 1]],
    [[0.25, 0.75], [NAN, NAN]],
    [[0, 0], [0.5, 0.5]],
]
R = [[-1, -2, -np.inf], [-1, NAN, 5]]
SEEN = [[[1, 0], [0, 1]]] * 3


def rooms(kind=MDP, **options):
    """Return a hall where one can walk, and a door that one can open."""
    options = {"discount": 0.9, "available": [HALL, DOOR], "initial_belief": [1, 0], **NAMES, **options}
    transitions, rewards = options.pop("T", T), options.pop("R", R)
    if kind is MDP:
        return MDP(transitions, rewards, **options)
    seen = options.pop("O", SEEN)
    return POMDP(transitions, seen, rewards, observation_names=["hall", "door"], **options)


@pytest.mark.parametrize("kind", [MDP, POMDP])
@pytest.mark.parametrize("sparse", [False, True])
def test_what_is_not_available_counts_for_nothing_and_the_first_stands_in(kind, sparse):
    given = [csr_array(np.nan_to_num(each)) for each in T] if sparse else T
    model = rooms(kind, T=given, sparse=sparse)
    assert model.available.tolist() == [HALL, DOOR]
    assert model.rewards.tolist() == [[-1, -2, -1], [-1, -1, 5]]
    assert model.transition("open", "hall").tolist() == [1, 0]
    assert model.transition("walk", "door").tolist() == [0, 1]
    assert model.transition("walk", "hall").tolist() == [0.25, 0.75]
    assert model.transition("open", "door").tolist() == [0.5, 0.5]


def test_a_function_of_names_says_it_too():
    model = rooms(available=lambda state, action: {"walk": state == "hall", "open": state == "door"}.get(action, True))
    assert model.available.tolist() == [HALL, DOOR]
    assert digest(model) == digest(rooms())


def test_rewards_of_outcomes():
    outcomes = np.zeros((3, 2, 2))
    outcomes[0], outcomes[1, 0], outcomes[1, 1], outcomes[2, 1] = 1, 2, NAN, 3
    assert rooms(R=outcomes).rewards.tolist() == [[1, 2, 1], [1, 1, 3]]


def test_where_all_are_available_nothing_is_said():
    fine = {"T": [[[1, 0], [0, 1]]] * 3, "R": np.zeros((2, 3))}
    model = rooms(available=np.ones((2, 3), dtype=bool), **fine)
    assert model.available is None
    assert digest(model) == digest(rooms(available=None, **fine))
    assert digest(rooms(**fine)) != digest(model)
    assert parts(rooms(**fine)).keys() - parts(model).keys() == {"available actions"}
    assert first_difference(model, rooms(**fine)) == "whether 'open' is available in 'hall' is another thing"


@pytest.mark.parametrize(
    ("available", "kind"),
    [
        ([[True, True], [True, True]], MDP),
        ([[1, 1, 0], [1, 0, 1]], MDP),
        ([HALL, [False] * 3], MDP),
        (lambda state, action: None, MDP),
        ([HALL, DOOR, DOOR], POMDP),
    ],
)
def test_what_is_no_availability_is_refused(available, kind):
    with refused(ModelError):
        rooms(kind, available=available)


@pytest.mark.parametrize(
    "options",
    [{"initial_belief": [0.5, 0.5]}, {"O": [[[1, 0], [0, 1]], [[0.9, 0.1], [0, 1]], [[1, 0], [0.5, 0.5]]]}],
)
def test_an_agent_that_would_not_know_what_is_available_is_refused(options):
    with refused(ModelError):
        rooms(POMDP, **options)


def test_missed_observations_are_refused():
    with refused(ModelError):
        rooms(POMDP).with_false_negatives("hall")


def test_an_infinite_reward_is_refused_with_the_way_out():
    for rewards in ([[-1, -2, -np.inf], [-1, 0, 5]], [[-1, -2, np.inf], [-1, 0, 5]]):
        with refused(ModelError):
            MDP([np.eye(2)] * 3, rewards, discount=0.9, **NAMES)


def test_a_text_with_an_infinite_reward_is_refused_with_the_way_out(tmp_path):
    text = "discount: 0.9\nvalues: reward\nstates: 2\nactions: 2\nT: *\nidentity\nR: 1 : 0 : * {}\n"
    for value in ("-inf", "1"):
        (tmp_path / "x.mdp").write_text(text.format(value))
        if value == "1":
            assert mdm.load_model(tmp_path / "x.mdp").rewards[0, 1] == 1
        else:
            with refused(mdm.FormatError):
                mdm.load_model(tmp_path / "x.mdp")


@pytest.mark.parametrize("kind", [MDP, POMDP])
@pytest.mark.parametrize("sparse", [None, True, False])
def test_an_archive_keeps_it_and_other_formats_refuse(tmp_path, kind, sparse):
    model = rooms(kind)
    mdm.save_model(model, tmp_path / "rooms.npz")
    read = mdm.load_model(tmp_path / "rooms.npz", sparse=sparse)
    assert read.available.tolist() == [HALL, DOOR]
    assert digest(read) == digest(rooms(kind, sparse=sparse))
    with refused(ModelError):
        mdm.save_model(model, tmp_path / ("rooms.mdp" if kind is MDP else "rooms.pomdp"))


@pytest.mark.parametrize("kind", [MDP, POMDP])
def test_it_goes_with_other_discounts_and_with_durations(kind):
    model = rooms(kind)
    assert model.with_discount(0.5).available.tolist() == [HALL, DOOR]
    timed = in_time(model.with_discount(0.5, of="second"), Durations([[1.0, 2.0, 3.0]] * 2))
    assert timed.available.tolist() == [HALL, DOOR, [True] * 3]
