"""Descriptions in records: a system that a program makes is read from its record as one from a file is."""

from __future__ import annotations

import asyncio
import json
import tempfile
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from sentences import refused

import mdm
from mdm import Ensemble, Error, ObservationFactor, PredicateManager, StateFactor, problems
from mdm.cli.records.page import recorded_run
from mdm.config.description import describe
from mdm.config.rebuilt import rebuilt
from mdm.config.recorded import attach_configuration
from mdm.estimation import as_data, chains_of_records, statistics
from mdm.explanation import explain
from mdm.policies import AlphaVectors, BeliefPolicy, DeterministicPolicy, FiniteStateController, QTable
from mdm.recording import Record, Recorder
from mdm.recording.table import names_of
from mdm.replay.retraced import decisions_of, retraced
from mdm.team import Network, Team
from mdm.testing import replay, run_virtual

pytestmark = pytest.mark.usefixtures("recorded_here")

TIGER = problems.tiger()
VECTORS = AlphaVectors([[19.4, 19.4], [-81.6, 28.4], [28.4, -81.6]], [0, 1, 2])
PLAN = FiniteStateController([0, 1, 2], [[1, 2], [0, 0], [0, 0]])
ROOM = mdm.MDP.from_functions(
    ["near", "far"],
    ["rest", "go"],
    transition=lambda s, a: s if a == "rest" else {"near": 0.8, "far": 0.2},
    reward=lambda s, a: (s == "near") - 0.1 * (a == "go"),
    discount=0.9,
)
VALUES = QTable([[9.1, 8.3], [2.5, 7.75]])

DECLARED = """
[predicates]
Low = { max_age = 5.0, initial = false }
Close = { when = "< 0.2 until > 0.3" }
Near = { formula = "Close & ~Low", held_for = 0.25 }
Far = "~Near"
Careful = { monitor = "G(not Near) U \\"G\\" or F(Low)" }
G = {}
Held = { set = "HearLeft", reset = "HearRight & Low", initial = true }
[events]
HearLeft = {}
HearRight = {}
Rose = "Near"
"""


def declared():
    manager = PredicateManager()
    manager.sensor("Low", max_age=5.0, initial=False)
    manager.sensor("Close", when="< 0.2 until > 0.3")
    manager.define("Near", "Close & ~Low", held_for=0.25)
    manager.define("Far", "~Near")
    manager.monitor("Careful", 'G(not Near) U "G" or F(Low)')
    manager.sensor("G")
    manager.latch("Held", set="HearLeft", reset="HearRight & Low", initial=True)
    manager.event("HearLeft")
    manager.event("HearRight")
    manager.event("Rose", "Near")
    return manager


def tables(name, observed, actions, **options):
    lines = [f"[ensembles.{name}]", *(f"{key} = {json.dumps(value)}" for key, value in options.items())]
    for table, values in observed.items():
        lines += [f"[ensembles.{name}.{table}]", values]
    return "\n".join([*lines, f"[ensembles.{name}.actions]", *actions, ""])


def nothing():
    pass


async def lasting():
    await asyncio.sleep(0.3)


def same_actions(names):
    return dict.fromkeys(names, nothing), [f'{name} = "code:{name.replace("-", "_")}"' for name in names]


def table(folder):
    """An MDP and a Q-table, decided on a factor that names the model's values."""
    mdm.save_model(ROOM, folder / "room.npz")
    mdm.save_policy(VALUES, folder / "room.policy")
    own, lines = same_actions(ROOM.action_space.names)
    wired = {"states": 'place = { predicates = { near = "Near", far = "Far" }, on_violation = "hold" }'}
    text = tables("robot", wired, lines, model="room.npz", policy="room.policy", on_unknown="continue", horizon=7)
    manager = declared()
    states = [StateFactor("place", {"far": "Far", "near": "Near"}, on_violation="hold")]
    options = {"on_unknown": "continue", "horizon": 7}
    robot = Ensemble("robot", policy=VALUES, model=ROOM, predicates=manager, states=states, actions=own, **options)
    return text, manager, [robot], "robot"


def tiger(policy, file, **options):
    def make(folder):
        mdm.save_model(TIGER, folder / "tiger.npz")
        mdm.save_policy(policy, folder / file, TIGER)
        own, lines = same_actions(TIGER.action_space.names)
        wired = {"observations": 'ears = { hear-left = "HearLeft", hear-right = "HearRight" }'}
        text = tables("robot", wired, lines, model="tiger.npz", policy=file, **options)
        manager = declared()
        ears = ObservationFactor("ears", {"hear-left": "HearLeft", "hear-right": "HearRight"})
        given = {"predicates": manager, "observations": [ears], "actions": own}
        return text, manager, [Ensemble("robot", policy=policy, model=TIGER, **given, **options)], "robot"

    return make


def hierarchy(folder):
    """Two levels without a model, an action that lasts, and one that is the safe action."""
    (folder / "code.py").write_text("async def wait():\n    pass\n")
    wired = {"states": 'near = ["Near"]'}
    above = ['work = { ensemble = "inner", resume = true }', 'rest = { call = "code:rest", then = "wait" }']
    text = tables("outer", wired, above, policy=[1, 0], safe_action="rest")
    below = ['first = { call = "code:wait", timeout = 2.0, on_repeat = "restart" }', 'second = "code:second"']
    text += tables("inner", {"states": 'low = { yes = "Low" }'}, below, policy=[0, 1])
    manager = declared()
    inner = Ensemble(
        "inner",
        policy=DeterministicPolicy([0, 1], 2),
        predicates=manager,
        states=[StateFactor("low", {"yes": "Low"})],
        actions={"first": mdm.bind(lasting, timeout=2.0, on_repeat="restart"), "second": nothing},
    )
    outer = Ensemble(
        "outer",
        policy=[1, 0],
        predicates=manager,
        states=[StateFactor("near", ["Near"])],
        actions={"work": mdm.bind(inner, resume=True), "rest": mdm.bind(nothing, then="wait")},
        safe_action="rest",
    )
    return text, manager, [outer], "outer"


def team_of_one(folder):
    text, manager, [robot], _ = tiger(VECTORS, "tiger.vf")(folder)
    team = Team("solo", ["ada"], period=0.5, lease=2.0)
    text = text.replace("[ensembles.robot]", "[ensembles.robot]\nplacement = {}", 1)
    text += '[team]\nname = "solo"\nagents = ["ada"]\nperiod = 0.5\nlease = 2.0\n'
    return text, manager, (team, robot), "ada/robot"


KINDS = {
    "table": table,
    "vectors": tiger(VECTORS, "tiger.vf", drive=2.0, initial_belief=[0.25, 0.75]),
    "plan": tiger(PLAN, "tiger.npz.policy.npz", on_impossible="reset"),
    "hierarchy": hierarchy,
    "team": team_of_one,
}
SENSED = st.one_of(
    st.tuples(st.just("Low"), st.sampled_from([True, False, None])),
    st.tuples(st.just("Close"), st.floats(0, 0.5)),
    st.tuples(st.sampled_from(["HearLeft", "HearRight"]), st.none()),
)


def ran(path, make, sensed, *, recorder=None):
    """Record a system that is told all of this, three times a second; return what the runtime explains at the end."""
    explained = {}

    async def main(runtime):
        manager, actors, paths = make(runtime)
        for actor in actors:
            await runtime.start(actor)
        await asyncio.sleep(0.05)
        for name, value in sensed:
            manager.occur(name) if name.startswith("Hear") else manager.sense(name, value)
            await asyncio.sleep(0.31)
        for each in paths:
            try:
                explained[each] = runtime.explain(each)
            except Error:  # it has decided nothing
                explained[each] = None

    run_virtual(main, record=path if recorder is None else recorder, log=False)
    return explained


def both(kind, folder, sensed):
    """Return the records of a system from a file and from a program, and what the latter was explained as it ran."""
    text, manager, actors, path = KINDS[kind](folder)
    file = folder / "robot.toml"
    file.write_text(DECLARED + text)
    team = isinstance(actors, tuple)
    agent = "ada" if team else None
    recorder = Recorder(folder / "file.mcap")
    attach_configuration(recorder, file, agent=agent)

    def of_file(runtime):
        carrier = Network(runtime.clock, team="solo").transport("ada") if team else None
        system = mdm.load_system(file, callbacks=False, agent=agent, transport=carrier)
        return system.predicates, [system], [path]

    def of_program(runtime):
        if not team:
            return manager, [manager, *actors], [path]
        member = actors[0].member("ada", actors[1], transport=Network(runtime.clock, team="solo").transport("ada"))
        return manager, [manager, member], [path]

    ran(folder / "file.mcap", of_file, sensed, recorder=recorder)
    explained = ran(folder / "program.mcap", of_program, sensed)
    return Record(folder / "file.mcap"), Record(folder / "program.mcap"), explained


def explanations(record):
    """Return why each decision of a record was made, as `mdm explain` says it."""
    with tempfile.TemporaryDirectory() as folder:
        ensembles = rebuilt(record, folder).ensembles
        told = []
        for path in dict.fromkeys(each.ensemble for each in decisions_of(record)):
            own = [each for each in decisions_of(record) if each.ensemble == path]
            for place in range(len(own)):
                step = retraced(ensembles[path].controller, own, place)
                told.append((path, explain(ensembles[path].named(step.case(10)))))
        return told


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=2, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(sensed=st.lists(SENSED, min_size=1, max_size=5))
def test_both_records_tell_the_same(kind, sensed):
    check_both(kind, sensed)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(sensed=st.lists(SENSED, min_size=1, max_size=12))
def test_both_records_of_many_runs_tell_the_same(kind, sensed):
    check_both(kind, sensed)


def check_both(kind, sensed):
    sensed = [("Low", False), ("Close", 0.1), *sensed]
    with tempfile.TemporaryDirectory() as place:
        file, program, explained = both(kind, Path(place), sensed)
        assert program.head["configuration"] == "system.json"
        assert program.cannot == ()
        assert names_of(file) == names_of(program)
        told = explanations(program)
        assert told == explanations(file)
        for path, live in explained.items():
            assert live is None or live == [each for ensemble, each in told if ensemble == path][-1]
        assert replay(program.path) == replay(file.path) == len(decisions_of(program))
        shown = [recorded_run(record.path) for record in (file, program)]
        (one, other) = [run.scene() for run in shown]
        assert (one.ensembles, one.predicates, one.remarks) == (other.ensembles, other.predicates, other.remarks)
        times = np.linspace(0.0, min(run.last for run in shown), 9)
        assert [shown[0].frame(time).predicates for time in times] == [
            shown[1].frame(time).predicates for time in times
        ]
        if kind in {"table", "vectors"}:
            counts = []
            for record in (file, program):
                with tempfile.TemporaryDirectory() as folder:
                    model = rebuilt(record, folder).ensembles["robot"].controller.model
                    counts.append(as_data(statistics(chains_of_records([record], "robot", model), model, seed=1)))
            assert msgspec.json.encode(counts[0]) == msgspec.json.encode(counts[1])


# -- What a record does not hold ---------------------------------------------------------------------------------


class Careful(BeliefPolicy):
    num_states, num_actions = 2, 3

    def action(self, belief):
        return 0 if belief.max() < 0.9 else 1 + int(belief.argmax() == 0)


class Tracker:
    """Takes each observation for the truth."""

    current = np.array([0.5, 0.5])

    def reset(self, initial=None):
        self.current = np.array([0.5, 0.5])

    def update(self, action, observation):
        self.current = np.eye(2)[observation] if observation is not None else self.current
        return 1.0


def heard(path, robot, manager, *before):
    events = [("HearLeft", None)] * 4
    return ran(path, lambda _: (manager, [*before, robot], ["robot"]), events)["robot"]


def ears(manager):
    return {
        "predicates": manager,
        "observations": [ObservationFactor("ears", ["HearLeft", "HearRight"])],
        "actions": dict.fromkeys(TIGER.action_space.names, nothing),
    }


def test_a_policy_that_is_code_is_named_and_the_rest_is_there(tmp_path):
    manager = declared()
    robot = Ensemble("robot", policy=Careful(), model=TIGER, **ears(manager))
    live = heard(tmp_path / "run.mcap", robot, manager)
    record = Record(tmp_path / "run.mcap")
    sentence = "the policy of ensemble 'robot', Careful, is code, which a record does not hold"
    assert record.cannot == (sentence,)
    told = explanations(record)[-1][1]
    assert told.cannot == (sentence,)
    assert (told.action_name, told.belief, told.next_states) == (live.action_name, live.belief, live.next_states)
    run = recorded_run(record.path)
    assert run.scene().remarks == (sentence,)
    assert run.frame(run.last).predicates[-1] is True  # Held, which a replay with the recorded decisions tells
    with refused(Error):
        replay(record.path)
    again = declared()
    assert replay(record.path, Ensemble("robot", policy=Careful(), model=TIGER, **ears(again))) == 5


def test_a_tracker_that_is_code_is_said(tmp_path):
    manager = declared()
    robot = Ensemble("robot", policy=VECTORS, model=TIGER, tracker=Tracker(), **ears(manager))
    heard(tmp_path / "run.mcap", robot, manager)
    record = Record(tmp_path / "run.mcap")
    assert record.cannot == ("the tracker of ensemble 'robot' is code, which a record does not hold",)
    assert recorded_run(record.path).scene().remarks[:1] == record.cannot
    with refused(Error):
        replay(record.path)


def test_ensembles_that_one_description_has_no_room_for_are_named(tmp_path):
    manager, other = declared(), declared()
    first, second = (
        Ensemble(name, policy=VECTORS, model=TIGER, **ears(each))
        for name, each in (
            ("robot", manager),
            ("rover", other),
        )
    )
    heard(tmp_path / "run.mcap", first, manager, second)
    record = Record(tmp_path / "run.mcap")
    assert record.cannot == (
        "ensemble 'robot' has another predicate manager than one that is described, and is not described itself",
    )


def test_a_model_that_is_too_large_is_not_kept_and_said(monkeypatch):
    monkeypatch.setattr("mdm.config.description.LARGEST", 100)
    manager = declared()
    described, files = describe([Ensemble("robot", policy=VECTORS, model=TIGER, **ears(manager))])
    assert described.cannot[0].startswith("the model of ensemble 'robot' is not in the record: it takes ")
    assert files == {}


def test_an_ensemble_below_an_actor_of_the_program_has_its_path(tmp_path):
    manager = PredicateManager("senses")
    manager.sensor("Low", initial=False)
    robot = Ensemble(
        "robot",
        policy=[0, 1],
        predicates=manager,
        states=[StateFactor("low", ["Low"])],
        actions={"a": nothing, "b": nothing},
    )
    rig = mdm.Actor("rig")
    rig.add(robot)
    ran(tmp_path / "run.mcap", lambda _: (manager, [rig], ["rig/robot"]), [("Low", True), ("Low", False)])
    record = Record(tmp_path / "run.mcap")
    assert [path for path, _ in explanations(record)] == ["rig/robot"] * 3
    assert replay(record.path) == 3
    run = recorded_run(record.path)
    assert run.scene().remarks == ()
    assert [each.name for each in run.scene().predicates] == ["Low"]


def test_an_ensemble_that_starts_later_is_described_too(tmp_path):
    manager = PredicateManager()
    manager.sensor("Low", initial=False)
    made = [
        Ensemble(
            name,
            policy=[0, 1],
            predicates=manager,
            states=[StateFactor("low", ["Low"])],
            actions={"a": nothing, "b": nothing},
        )
        for name in ("robot", "rover")
    ]

    async def main(runtime):
        await runtime.start(manager)
        for robot in made:
            await runtime.start(robot)
            await asyncio.sleep(1)

    run_virtual(main, record=tmp_path / "run.mcap")
    record = Record(tmp_path / "run.mcap")
    assert [path for path, _ in explanations(record)] == ["robot", "rover"]
    names = [each.name for each in record.attachments]
    assert len(names) == len(set(names)) == 2  # their policy, once, and the newest description


def test_who_is_not_there_is_not_explained():
    manager = declared()
    robot = Ensemble("robot", policy=VECTORS, model=TIGER, **ears(manager))

    async def main(runtime):
        with refused(Error):
            runtime.explain("robot")
        await runtime.start(robot)
        assert runtime.explain("robot").action_name == "listen"
        with refused(Error):
            runtime.explain("rover")

    run_virtual(main)


def test_a_map_that_tells_predicates_is_said_to_be_missing():
    manager = declared()
    manager.declared.age(["Far"], 5.0, "places")
    described, _ = describe([Ensemble("robot", policy=VECTORS, model=TIGER, **ears(manager))])
    assert described.cannot == ("the map that predicates are told by is not in the record: a replay knows no places",)
