"""Models from maps, against the original's recorded policy, plain sums, and poses drawn at random."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from maps.floors import FURNITURE, flat, offices
from sentences import refused

import mdm
from mdm.errors import MapError
from mdm.maps import Edge, Frame, Graph, Grid, Map, Node, Pose, check, draft
from mdm.maps.model import FloorFactor, arrivals, durations, latch, model, sightings

ROOMS = ("SoccerField", "LRM", "SouthCorridor", "CoffeeRoom", "WestCorridor", "ElevatorHallway")
WAYS = (
    ("ElevatorHallway", "Up", "WestCorridor"),
    ("WestCorridor", "Down", "ElevatorHallway"),
    ("WestCorridor", "Left", "SouthCorridor"),
    ("CoffeeRoom", "Down", "SouthCorridor"),
    ("SouthCorridor", "Down", "LRM"),
    ("SouthCorridor", "Right", "WestCorridor"),
    ("SouthCorridor", "Up", "CoffeeRoom"),
    ("LRM", "Down", "SoccerField"),
    ("LRM", "Up", "SouthCorridor"),
    ("SoccerField", "Up", "LRM"),
)
RECORDED = (0, 0, 0, 1, 3, 1, 1, 1, 1, 2, 0, 0)
"""The policy of the MDM package's demo (larsys/markov_decision_making, mdm_example/config/MDP_policy): of Up, Down,
Left, Right in each room, before half of the round and after."""


def isr():
    nodes = tuple(Node(name, Pose(float(index), 0.0)) for index, name in enumerate(ROOMS))
    return Graph(nodes, tuple(Edge(source, target, label) for source, label, target in WAYS))


def test_the_patrol_of_the_original_is_what_its_recorded_policy_does():
    graph = isr()
    halfway = latch(graph, "PatrolHalfwayThrough", on="ElevatorHallway", off="SoccerField")
    patrol = model(graph, factors=[halfway], success=0.9, discount=0.95)
    assert [factor.name for factor in patrol.state_space.factors] == ["position", "PatrolHalfwayThrough"]
    policy = mdm.solve(patrol, gap=1e-6).policy
    names = patrol.action_space.factors[0].names
    found = [("Up", "Down", "Left", "Right").index(names[policy.action(state)]) for state in range(12)]
    never = {ROOMS.index("SoccerField") * 2 + 1, ROOMS.index("ElevatorHallway") * 2}  # the latch turns on arrival
    assert [found[state] for state in range(12) if state not in never] == [
        RECORDED[state] for state in range(12) if state not in never
    ]


def test_probabilities_and_rewards_are_those_that_were_asked_for():
    graph = isr()
    lit = np.tile([[0.9, 0.1], [0.0, 1.0]], (6, 1, 1))
    lamp = FloorFactor("lamp", ("off", "on"), lit, np.tile([[0.0, 2.0], [0.0, 0.0]], (6, 1, 1)), initial=(0.5, 0.5))
    made = model(graph, factors=[lamp], success=0.8, rewards={"LRM": 5.0}, start="LRM", stay="Stay", idle_cost=0.25)
    assert made.transition("Down", "LRM off", "SoccerField on") == pytest.approx(0.8 * 0.1)
    assert made.transition("Down", "LRM on", "LRM on") == pytest.approx(0.2)
    assert made.transition("Stay", "LRM off", "LRM off") == pytest.approx(0.9)
    assert made.reward("Down", "LRM off") == pytest.approx(0.2 * 5.0 + 0.1 * 2.0)
    assert made.reward("Left", "LRM on") == pytest.approx(5.0 - 0.25)
    assert made.reward("Stay", "LRM on") == pytest.approx(5.0)
    assert made.initial_belief[made.state_space.index("LRM off")] == 0.5


def test_ways_take_as_long_as_their_paths():
    floor = offices(furniture=FURNITURE[offices]).map()
    seconds = arrivals(floor, speed=0.5)
    names, labels = floor.graph.names, floor.graph.labels
    for edge in floor.graph.edges:
        one, other = floor.graph.node(edge.source).goal, floor.graph.node(edge.target).goal
        straight = math.dist((one.x, one.y), (other.x, other.y)) / 0.5
        taken = seconds[names.index(edge.source), labels.index(edge.label)]
        assert straight - 0.3 <= taken <= 2.0 * straight
    assert np.isfinite(seconds).all()
    made = model(floor.graph, factors=[latch(floor.graph, "half", on="lab", off="west")])
    table, _ = durations(made, seconds).table(made)
    state = made.state_space.index("lab yes")
    action = made.action_space.index("to hall")
    assert table[state, action] == seconds[names.index("lab"), labels.index("to hall")]
    solution = mdm.solve(made.with_discount(0.99, of="second"), durations=durations(made, seconds))
    assert solution.upper - solution.lower < 1e-2


def test_sightings_are_those_of_poses_drawn_at_random():
    floor = flat().map()
    noise = 0.6
    seen = sightings(floor, noise)
    np.testing.assert_allclose(seen.sum(axis=1), 1.0)
    assert (np.diag(seen) > 0.75).all()
    generator = np.random.default_rng(3)
    fits = floor.grid.clearance() > 0.25
    for place, name in enumerate(floor.graph.names):
        cells = np.argwhere(floor.labels.cells(name) & fits)
        drawn = [floor.labels.frame.centre(*cells[index]) for index in generator.integers(len(cells), size=4000)]
        found = [floor.labels.name(*(np.array(at) + noise * generator.normal(size=2))) for at in drawn]
        known = [name for name in found if name is not None]
        shares = [known.count(other) / len(known) for other in floor.graph.names]
        np.testing.assert_allclose(seen[place], shares, atol=0.03)


def test_with_sightings_it_is_a_model_with_observations():
    floor = flat().map()
    made = model(floor.graph, sightings=sightings(floor, 0.3))
    assert made.kind == "POMDP"
    assert made.observation("to living", "bath", "bath") > 0.8
    assert sightings(floor, 0.0).tolist() == np.eye(6).tolist()


@pytest.mark.parametrize("suffix", ["pomdpx", "pgmx", "npz"])
def test_models_are_written_and_read(tmp_path, suffix):
    floor = flat().map()
    made = model(
        floor.graph, factors=[latch(floor.graph, "half", on="bath", off="study")], sightings=sightings(floor, 0.3)
    )
    path = tmp_path / f"floor.{suffix}"
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mdm.save_model(made, path)
    # SARSOP's parser knows no links between the next values of factors: the latch turns where the robot arrives.
    joined = any("the 2 state factors depend on each other" in str(one.message) for one in told)
    assert joined == (suffix == "pomdpx")
    read = mdm.load_model(path)
    for action in range(len(made.action_space)):
        np.testing.assert_allclose(
            np.asarray(read.transition_matrix(action).todense() if read.is_sparse else read.transition_matrix(action)),
            np.asarray(made.transition_matrix(action).todense() if made.is_sparse else made.transition_matrix(action)),
            atol=1e-12,
        )
    np.testing.assert_allclose(read.rewards, made.rewards, atol=1e-9)


def test_what_fits_by_the_check_has_paths(tmp_path):
    """A door of nine cells of 0.05 m lets pass a robot of 0.2 m, with 0.05 m on each side: both say so."""
    free = np.zeros((60, 100), dtype=bool)
    free[5:55, 5:48] = free[5:55, 52:95] = free[20:29, 48:52] = True
    nodes = Node("a", Pose(1.0, 1.0)), Node("b", Pose(4.0, 0.5))
    graph = Graph(nodes, (Edge("a", "b", "go"), Edge("b", "a", "back")))
    grid = Grid(Frame(60, 100, 0.05), free, ~free)
    floor = Map(draft(grid, graph), graph, grid)
    assert check(floor, radius=0.2, margin=0.1) == ()
    assert np.isfinite(arrivals(floor, speed=1.0, radius=0.2)).all()
    assert len(check(floor, radius=0.21, margin=0.1)) == 1
    with refused(MapError):
        arrivals(floor, speed=1.0, radius=0.21)


def with_factor(floor, name, values):
    return model(floor.graph, factors=[FloorFactor(name, values, np.tile(np.eye(2), (6, 1, 1)))])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda floor: model(Graph(floor.graph.nodes, ())), "no ways, so that there is nothing to decide"),
        (lambda floor: model(floor.graph, success=1.5), "1.5 is no probability"),
        (lambda floor: model(floor.graph, success=np.ones((2, 2))), r"the shape \(2, 2\), not \(6, 6\)"),
        (lambda floor: model(floor.graph, start="attic"), "no place 'attic'"),
        (lambda floor: model(floor.graph, stay="to bath"), "'to bath' is a way of the map"),
        (
            lambda floor: latch(floor.graph, "half", on="bath", off="bath"),
            "'half' would be switched on and off in 'bath'",
        ),
        (lambda floor: arrivals(floor, speed=0.0), "a speed of 0.0 brings no robot anywhere"),
        (
            lambda floor: arrivals(floor, speed=1.0, radius=0.5),
            "no path from 'bath' to 'entrance'|'entrance' to 'bath'",
        ),
        (lambda floor: arrivals(floor, speed=1.0, radius=9.0), "does not fit at the goal of 'entrance'"),
        (lambda floor: sightings(floor, -1.0), "a noise of -1.0 is no standard deviation"),
        (lambda floor: sightings(floor, 0.1, radius=-1.0), "the radius is a number of metres, 0 or more, not -1.0"),
        (lambda floor: arrivals(floor, speed=1.0, radius="a"), "the radius is a number of metres, 0 or more, not 'a'"),
        (lambda floor: model(floor.graph, success="often"), "the probabilities of success are no array of numbers"),
        (lambda floor: model(floor.graph, rewards={"bath": math.nan}), "the reward of 'bath' is nan: give a number"),
        (lambda floor: model(floor.graph, rewards={"bath": "1"}), "the reward of 'bath' is '1': give a number"),
        (lambda floor: model(floor.graph, idle_cost=math.inf), "the idle cost is inf: give a number"),
        (lambda floor: model(floor.graph, factors=["fire"]), "'fire' is no factor: give a list of FloorFactor objects"),
        (
            lambda floor: latch(floor.graph, "half", on="bath", off="study", reward=math.nan),
            "the reward of 'half' is nan",
        ),
        (
            lambda floor: durations(model(floor.graph), np.ones((6, 9))),
            r"the seconds have the shape \(6, 9\); the model has 6 places",
        ),
        (lambda floor: sightings(floor, 1e9), r"a noise of 1e\+09 m is more than the map is across"),
        (lambda floor: model(floor.graph, stay=" "), "the action that stays has no name"),
        (lambda floor: with_factor(floor, 3, ("a", "b")), "a factor is called 3: give it a name, as text"),
        (lambda floor: with_factor(floor, "", ("a", "b")), "a factor is called ''"),
        (lambda floor: with_factor(floor, "lamp", ()), r"the values of 'lamp' are \(\): give a list of names"),
        (lambda floor: with_factor(floor, "lamp", None), "the values of 'lamp' are None"),
        (lambda floor: with_factor(floor, "lamp", "ab"), "the values of 'lamp' are 'ab'"),
        (lambda floor: with_factor(floor, "lamp", (1, 2)), "a value of 'lamp' is 1: give it a name, as text"),
    ],
)
def test_what_makes_no_model_is_refused(wrong, message):
    with pytest.raises(MapError, match=message):
        wrong(flat().map())
