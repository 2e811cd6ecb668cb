import numpy as np
import pytest
from enumerated import closure, policies
from random_processes import model_of_rows, random_rows

from mdm.models.matrices import csr
from mdm.models.specification import Specification
from mdm.verification.choices import Choices, Graph, components, end_components, graph_of

RANDOM = np.random.default_rng(11)
CASES = [random_rows(RANDOM, 5, 2) for _ in range(15)]


def choices_of(rows, text="P(reach s1 before s2)"):
    model = model_of_rows(rows)
    asked = Specification.of(text, model)
    return Choices.of_model(model, asked.target, asked.before)


def certain_of(chain, state):
    """Whether a chain reaches state 1 before state 2 for certain, and whether it may."""
    reached = closure(chain, state, {1, 2})
    return 2 not in reached and all(1 in closure(chain, each, {1, 2}) for each in reached), 1 in reached


@pytest.mark.parametrize("rows", CASES)
def test_what_is_certain_and_impossible_is_so_for_all_policies(rows):
    graph = Graph(choices_of(rows))
    told = [[certain_of(chain, state) for chain in policies(rows)] for state in range(len(rows))]
    assert graph.certain()[0].tolist() == [any(sure for sure, _ in each) for each in told]
    assert graph.impossible().tolist() == [not any(may for _, may in each) for each in told]
    assert graph.unavoidable()[0].tolist() == [all(sure for sure, _ in each) for each in told]
    assert graph.avoiding()[0].tolist() == [any(not may for _, may in each) for each in told]


@pytest.mark.parametrize("rows", CASES)
def test_end_components_are_where_policies_stay(rows):
    its = Choices.of_model(model_of_rows(rows), np.zeros((len(rows), 3), dtype=bool), None)
    component, stays = end_components(its, np.ones(len(its.state), dtype=bool))
    recurrent = [
        frozenset(closure(chain, state))
        for chain in policies(rows)
        for state in range(len(rows))
        if all(state in closure(chain, other) for other in closure(chain, state))
    ]
    assert {state for each in recurrent for state in each} == set(np.flatnonzero(component >= 0).tolist())
    for each in recurrent:
        assert len({component[state] for state in each}) == 1
    assert set(its.state[stays].tolist()) == set(np.flatnonzero(component >= 0).tolist())
    for number in range(component.max() + 1):
        (states,) = np.nonzero(component == number)
        part = graph_of(its.moves[stays], its.state[stays])[states][:, states].toarray() > 0
        reach = np.linalg.matrix_power(np.eye(len(states)) + part, len(states))
        assert (reach > 0).all()


def test_components_are_numbered_from_the_ends():
    random = np.random.default_rng(2)
    for _ in range(30):
        graph = csr(random.random((8, 8)) < 0.15)
        labels = components(graph)
        rows, columns = graph.nonzero()
        assert (labels[columns] <= labels[rows]).all()
