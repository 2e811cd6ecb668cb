"""Policies as pictures, against what the policies decide and against geometry of the test's own."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections import Counter
from dataclasses import dataclass

import numpy as np
import pytest
from decided import VECTORS, ensemble, nothing
from hypothesis import given, settings, strategies as st

from mdm import Controller, Ensemble
from mdm.explanation import Case
from mdm.models import Factor, Space
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    QTable,
    RandomPolicy,
    StagedPolicy,
    StochasticPolicy,
)
from mdm.problems import tiger
from mdm.recording import Record
from mdm.snapshots import LiveRun, RecordedRun
from mdm.snapshots.frame import EnsembleScene
from mdm.snapshots.picture import hierarchy, picture_of
from mdm.testing import run_virtual

STATES = Space(
    [Factor("room", ["hall", "lab", "attic"]), Factor("door", ["open", "shut"]), Factor("load", ["no", "yes"])]
)
ACTIONS = Space.single("action", ["go", "open", "drop"])
TABLE = DeterministicPolicy([0, 2, 1, 2] * 2 + [0, 0, 1, 1], 3)


def case(policy, at=None, states=None, actions=None, observations=None):
    return Case(policy, None, states, actions, observations, 0, -1, at)


def texts(picture, kind, *, lit=None):
    return [each.text[0] for each in picture.shapes if each.kind == kind and lit in {None, each.lit}]


# -- Tables ------------------------------------------------------------------------------------------------------------


@given(st.lists(st.integers(0, 2), min_size=12, max_size=12), st.integers(0, 11))
@settings(max_examples=20)
def test_the_lit_way_of_a_table_leads_through_the_values_of_the_state_to_its_action(actions, state):
    picture = picture_of(case(DeterministicPolicy(actions, 3), state, STATES, ACTIONS))
    *asked, action = texts(picture, "box", lit=True)
    assert action == ACTIONS.names[actions[state]]
    values = {factor.name: factor.names[at] for factor, at in zip(STATES.factors, STATES.unravel(state), strict=True)}
    lit = texts(picture, "edge", lit=True)
    assert len(lit) == len(asked)
    for factor in asked:
        assert any(re.match(rf"{values[factor]}\b", text) for text in lit)
    assert set(texts(picture, "box")) <= {"room", "door", "load", *ACTIONS.names}


def test_a_table_without_names_is_drawn_by_numbers():
    picture = picture_of(case(QTable([[0, 1], [2, 1], [0, 5]]), 2))
    assert picture.title == "decides by state"
    assert texts(picture, "box", lit=True) == ["state", "1"]
    assert texts(picture, "edge", lit=True) == ["2, 0"]
    assert texts(picture_of(case(QTable([[0, 1]] * 3), None, STATES)), "box") == ["1"]  # of other states
    assert picture_of(case(QTable([[0, 1]] * 3))).title == "decides always the same"


def test_probabilities_and_stages_are_drawn():
    drawn = picture_of(
        case(StochasticPolicy([[1, 0.25], [0, 0.75]]), 1, None, Space.single("action", ["left", "right"]))
    )
    assert texts(drawn, "box", lit=True) == ["state", "right 75% or left 25%"]
    staged = Controller(StagedPolicy([[[0, 3], [1, 0]], [[1, 0], [1, 0]]]))
    staged.start(0)
    step = staged.see(0)
    drawn = picture_of(step.case())
    assert texts(drawn, "box", lit=True)[-1] == str(step.action) == "0"
    assert "decision" in texts(drawn, "box", lit=True)


def test_policies_that_are_code_are_not_asked():
    picture = picture_of(case(RandomPolicy(2, 2, input="state"), 0))
    assert not picture.shapes
    assert picture.remarks == ("it is code, or searches: only tables, controllers and alpha vectors have a picture",)


# -- Folding and the layout --------------------------------------------------------------------------------------------


def folded(seed=0):
    shape = (4, 25, 5, 2)
    states = Space([Factor(name, size, prefix="") for name, size in zip("abcd", shape, strict=True)])
    return states, DeterministicPolicy(np.random.default_rng(seed).integers(0, 5, shape).ravel().tolist(), 5)


@given(st.integers(0, 999))
@settings(max_examples=6)
def test_of_a_large_diagram_the_lit_way_is_drawn_whole_and_the_rest_is_counted(state):
    states, policy = folded()
    picture = picture_of(case(policy, state, states))
    assert texts(picture, "box", lit=True)[-1] == str(policy.action(state))
    assert len(texts(picture, "box", lit=True)) == len(texts(picture, "edge", lit=True)) + 1
    assert sum(each.kind == "box" for each in picture.shapes) <= 46
    assert re.fullmatch(r"\d+ of \d+ nodes are folded: press one to open it", picture.remarks[0])


def test_a_folded_node_says_how_many_it_stands_for_and_opens():
    controller = FiniteStateController([0] * 100, [[min(node + 1, 99), min(node + 1, 99)] for node in range(100)])
    picture = picture_of(case(controller, (0,)))
    shown = [each for each in picture.shapes if each.kind == "box"]
    fold = shown[-1]
    assert fold.text == (f"+ {100 - len(shown) + 1} folded",)  # a chain, of which the first are drawn
    after = picture_of(case(controller, (0,)), opened=[fold.opens])
    assert len(texts(after, "box")) == len(shown) + 1
    assert texts(after, "box")[-1] == f"+ {100 - len(shown)} folded"


def corners(shape):
    left, top, width, height = map(float, re.fullmatch(r"M(\S+) (\S+)h(\S+)v(\S+)h\S+z", shape.path).groups())
    return left, top, left + width, top + height


@given(st.integers(0, 10**6), st.integers(1, 60))
@settings(max_examples=15)
def test_no_two_boxes_and_no_two_texts_overlap(seed, nodes):
    random = np.random.default_rng(seed)
    rows = [
        [None if other == nodes else int(other) for other in row] for row in random.integers(0, nodes + 1, (nodes, 3))
    ]
    picture = picture_of(case(FiniteStateController(random.integers(0, 4, nodes).tolist(), rows, 4), (0,)))
    boxes = [corners(each) for each in picture.shapes if each.kind == "box"]
    for one, two in itertools.combinations(boxes, 2):
        assert one[2] <= two[0] or two[2] <= one[0] or one[3] <= two[1] or two[3] <= one[1]
    labels = [(each.x, each.y) for each in picture.shapes if each.kind == "edge"]
    for (x, y), (other, height) in itertools.combinations(labels, 2):
        assert abs(x - other) > 10 or abs(y - height) > 14
    for left, top, right, bottom in boxes:
        assert min(left, top) >= 0
        assert right <= picture.width
        assert bottom <= picture.height


# -- Controllers and hierarchies ---------------------------------------------------------------------------------------


def test_a_controller_has_its_edges_by_observation_and_its_node_lit():
    observations = Space.single("observation", ["quiet", "noise"])
    policy = FiniteStateController([0, 1, 2], [[0, 1], [2, 0], [None, 2]])
    picture = picture_of(case(policy, (1,), None, ACTIONS, observations))
    boxes = {each.text[0]: each for each in picture.shapes if each.kind == "box"}
    assert boxes["go"].text[1] == "↻ quiet"
    assert boxes["drop"].text[1] == "↻ noise"
    assert [each.text[0] for each in boxes.values() if each.lit] == ["open"]
    assert Counter(texts(picture, "edge")) == Counter(["noise", "quiet", "noise"])
    assert picture.remarks == ()
    assert {name: each.action for name, each in boxes.items()} == {name: name for name in ACTIONS.names}


def test_actions_and_nodes_that_nothing_leads_to_are_named():
    picture = picture_of(case(DeterministicPolicy([0, 1] * 6, 3), 0, STATES, ACTIONS))
    assert picture.remarks == ("never reached: drop",)
    plan = FiniteStateController([0, 1, 2], [[0], [0], [1]])
    assert picture_of(case(plan, (0,), None, ACTIONS)).remarks == ("never reached: node 1: open, node 2: drop",)


def test_a_controller_s_nodes_stay_where_they_are_whichever_is_lit():
    plan = FiniteStateController([0, 1, 2], [[1], [2], [2]])
    drawn = [picture_of(case(plan, (node,), None, ACTIONS)) for node in range(3)]
    first, *others = [{each.title: each.x for each in picture.shapes if each.kind == "box"} for picture in drawn]
    assert others == [first, first]
    assert len({*first.values()}) == 3


def test_of_a_team_each_agent_has_its_own_graph():
    listen = FiniteStateController([0], [[0, 0]], num_actions=3)
    names = ["listen", "left", "right"]
    space = Space([Factor("one", names), Factor("two", names)])
    picture = picture_of(case(JointController([listen, listen]), (0, 0), None, space))
    assert texts(picture, "box", lit=True) == ["agent 0: listen", "agent 1: listen"]


def test_a_hierarchy_has_the_running_children_lit():
    scenes = [
        EnsembleScene("top", -1, "", "", ("Fetch", "Rest")),
        EnsembleScene("top/fetch", 0, "Fetch", "", ("Go", "Grab")),
        EnsembleScene("alone", -1, "", "", ("Wait",)),
    ]
    running = {"top": ["Fetch"], "top/fetch": ["Grab"], "alone": ["Wait"]}
    picture = hierarchy(scenes, running, "top/fetch")
    assert texts(picture, "box", lit=True) == ["top", "Fetch", "fetch", "Grab"]
    assert set(texts(picture, "box", lit=False)) == {"Rest", "Go"}
    places = {each.text[0]: each.x for each in picture.shapes if each.kind == "box"}
    assert places["top"] < places["Fetch"] < places["fetch"] < places["Go"]
    assert (places["Fetch"], places["Go"]) == (places["Rest"], places["Grab"])
    assert hierarchy(scenes, running, "alone") is None
    many = [scenes[0], *(EnsembleScene(f"top/{name}", 0, "Rest", "", ("Go",)) for name in range(1000))]
    picture = hierarchy(many, running, "top/777")
    assert "777" in texts(picture, "box")
    assert len(picture.shapes) < 300


# -- Beliefs -----------------------------------------------------------------------------------------------------------


def areas(picture):
    for each in picture.shapes:
        if each.kind == "area":
            points = re.findall(r"[ML](\S+) (\S+?)(?=[Lz])", each.path)
            yield each.action, np.array(points, dtype=float)


def inside(points, x, y):
    """Whether a point is well inside a convex polygon."""
    following = np.roll(points, -1, axis=0)
    sides = (following[:, 0] - points[:, 0]) * (y - points[:, 1]) - (following[:, 1] - points[:, 1]) * (
        x - points[:, 0]
    )
    return (sides > 30).all() or (sides < -30).all()


@given(st.integers(0, 10**6), st.integers(2, 3), st.integers(1, 12))
@settings(max_examples=25)
def test_the_regions_are_those_of_the_greatest_vectors(seed, states, vectors):
    random = np.random.default_rng(seed)
    policy = AlphaVectors(random.integers(-5, 6, (vectors, states)), random.integers(0, 4, vectors).tolist(), 4)
    picture = picture_of(case(policy))
    found = list(areas(picture))
    every = np.concatenate([points for _, points in found])
    low, high = every.min(axis=0), every.max(axis=0)
    ends = np.array([[low[0], high[1]], high, [(low[0] + high[0]) / 2, low[1]]])[:states]
    for belief in random.dirichlet(np.ones(states), 20):
        x, y = belief @ ends
        y = y if states == 3 else (low[1] + high[1]) / 2
        for action, points in found:
            if inside(points, x, y):
                values = policy.vectors @ belief
                greatest = np.flatnonzero(values > values.max() - 1e-9)  # several where vectors are equal
                assert int(action) in {policy.actions[place] for place in greatest}
    sizes = [abs(np.dot(p[:, 0], np.roll(p[:, 1], 1)) - np.dot(p[:, 1], np.roll(p[:, 0], 1))) / 2 for _, p in found]
    whole = np.prod(high - low) / (2 if states == 3 else 1)
    assert sum(sizes) == pytest.approx(whole, rel=0.02)  # all beliefs, each once


def test_the_way_of_the_belief_ends_where_it_is_now():
    controller = Controller(VECTORS, tiger())
    controller.start()
    controller.observe("hear-left")
    step = controller.observe("hear-left")
    picture = picture_of(step.case())
    way, now = picture.shapes[-2:]
    points = np.array(re.findall(r"([\d.]+) ([\d.]+)", way.path), dtype=float)
    left, right = (
        next(each.x for each in picture.shapes if each.text == (name,)) for name in ("tiger-left", "tiger-right")
    )
    middle = (left + right) / 2
    beliefs = [0.5, 0.15, 0.15**2 / (0.15**2 + 0.85**2)]  # of the right door, by Bayes' rule
    assert points[:, 0] - middle == pytest.approx([260 * (belief - 0.5) for belief in beliefs], abs=0.2)
    assert now.path.startswith(f"M{points[-1][0]} {points[-1][1]}m")


def test_over_more_states_two_factors_are_drawn_where_the_state_is_known():
    random = np.random.default_rng(1)
    values = random.normal(size=(6, 12))
    policy = AlphaVectors(values, [0, 1, 2, 0, 1, 2], 3)
    belief = np.full(12, 0.02)
    belief[STATES.index("lab shut yes")] += 1 - belief.sum()
    picture = picture_of(case(policy, belief, STATES, ACTIONS))
    names = re.fullmatch(r"actions by (\w+) and (\w+)", picture.title).groups()
    (rest,) = {"room", "door", "load"} - set(names)
    present = {"room": "lab", "door": "shut", "load": "yes"}
    assert picture.remarks == (f"drawn for beliefs that are sure of the state, with {rest} {present[rest]}",)
    for each in picture.shapes:
        if each.kind == "area":
            row, column, action = re.fullmatch(r"(\w+) (\w+): (\w+)", each.title).groups()
            known = {rest: present[rest], names[0]: row, names[1]: column}
            state = STATES.index(" ".join(known[factor.name] for factor in STATES.factors))
            assert ACTIONS.names[policy.actions_at(np.eye(12)[[state]])[0]] == action
            assert each.lit == (known == present)
    alone = picture_of(case(AlphaVectors(values, [0, 1, 2, 0, 1, 2], 3)))
    assert alone.title == "actions by state"
    assert alone.remarks[0] == "drawn for beliefs that are sure of the state"


def test_a_policy_of_the_user_s_that_has_no_hash_has_no_picture_and_says_so():
    @dataclass
    class Careful:
        num_actions: int = 2

    assert picture_of(case(Careful())).remarks[0].startswith("it is code")


# -- Of runs -----------------------------------------------------------------------------------------------------------


def test_live_and_from_the_record_it_is_the_same_and_the_lit_action_is_the_recorded_one(tmp_path):
    def robots():
        table = Ensemble("table", policy=TABLE, actions=dict.fromkeys(range(3), nothing))
        plan = FiniteStateController([0, 1], [[0, 1], [1, 0]])
        return [ensemble(), table, Ensemble("plan", policy=plan, actions=dict.fromkeys(range(2), nothing))]

    async def main(runtime):
        live = LiveRun(runtime)
        live.open()
        robot, table, plan = found = robots()
        for each in found:
            await runtime.start(each)
        live.frame()
        first = await live.draw("table")
        for _ in range(2):
            robot.publish_observation("hear-left")
            await asyncio.sleep(1)
        table.publish_state(7)
        plan.publish_observation(1)
        await asyncio.sleep(1)
        live.frame()
        return first, [await live.draw(each.path) for each in found], await live.draw("nobody")

    first, told, nobody = run_virtual(main, record=tmp_path / "run.mcap")
    assert nobody == ()
    assert not any(shape.lit for shape in first[0].shapes)  # nothing was decided
    record = Record(tmp_path / "run.mcap")
    run = RecordedRun(record, ensembles={each.path: each for each in robots()})
    assert [asyncio.run(run.draw(each)) for each in ("robot", "table", "plan")] == told
    assert asyncio.run(run.draw("nobody")) == ()
    last = {each.message.ensemble: each.message for each in record.messages(["decisions"])}
    assert texts(told[1][0], "box", lit=True)[-1] == last["table"].action_name
    assert texts(told[2][0], "box", lit=True) == [last["plan"].action_name] == ["1"]
    alone = asyncio.run(RecordedRun(Record(tmp_path / "run.mcap")).draw("robot"))
    assert alone[0].remarks == ("its policy is not known here",)
