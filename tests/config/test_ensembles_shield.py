"""Shields of a file: a robot that is told to drive down the stairs does not, and says why to whoever asks."""

from __future__ import annotations

import asyncio

import pytest
import team_file
from hidden_dangers import tiger
from sentences import refused
from shielded import ACTIONS, CODE, SHIELD, STATES, WRONG, Kept, house, stand, written

import mdm
from mdm.cli.records.page import recorded_run
from mdm.config import load_system, look_over
from mdm.config.rebuilt import rebuilt
from mdm.errors import ConfigError
from mdm.estimation import as_text, chains_of_records, statistics
from mdm.formats import save_model, save_policy
from mdm.messages import Action
from mdm.policies import AlphaVectors, FiniteStateController
from mdm.policies.shielded import Budgeted
from mdm.recording import Record
from mdm.replay import replay
from mdm.testing import run_virtual


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


WHY = (
    "The policy wanted 'Straight', which may lead to position = stairs: next goal (0.75), stairs (0.25); "
    "the shield took 'Around' in its place."
)


def driven(folder, *, shield=SHIELD, log=None, record=None, policy=WRONG):
    """Drive from home to where the robot's actions lead by the house's most dangerous outcome; return what was told."""
    system = load_system(written(folder, shield, policy))
    told = {}

    async def drive(runtime):
        robot = system.ensembles["robot"]
        actions = []
        await runtime.start(system)
        robot.channel("action", Action).subscribe(actions.append)
        stand(system, "home")
        await asyncio.sleep(1)
        stand(system, "landing")
        await asyncio.sleep(1)
        told["why"] = str(runtime.explain("robot"))
        stand(system, "stairs" if actions[-1].index == 2 else "hall")
        await asyncio.sleep(1)
        told["actions"] = [(action.index, action.wanted) for action in actions]

    run_virtual(drive, log=log, **({} if record is None else {"record": record}))
    return told


def test_the_robot_would_drive_down_the_stairs_without_a_shield(folder):
    told = driven(folder, shield="")
    assert told["actions"] == [(2, None), (2, None), (0, None)]
    assert "shield" not in told["why"]


def test_with_one_it_does_not_and_says_why_in_the_log_in_the_record_and_to_who_asks(folder):
    kept, path = Kept(), folder / "run.mcap"
    told = driven(folder, log=kept, record=path)
    assert told["actions"] == [(2, None), (1, 2), (2, None)]
    assert WHY in told["why"]
    ((level, line),) = [(level, fields) for level, event, fields in kept.lines if event == "shielded"]
    assert level == "info"
    expected = {"time": 1.0, "ensemble": "robot", "state": "landing", "action": "Around", "wanted": "Straight"}
    assert line == {**expected, "avoids": "position = stairs"}
    record = Record(path)
    decisions = [each.message for each in record.messages(["decisions"])]
    assert [(each.action_name, each.wanted, each.wanted_name) for each in decisions] == [
        ("Straight", None, None),
        ("Around", 2, "Straight"),
        ("Straight", None, None),
    ]
    shown = recorded_run(path)
    assert [shown.frame(at).ensembles[0].wanted for at in (0.5, 1.5, 2.5)] == ["", "Straight", ""]
    assert "the shield took it in place of 'Straight'" in shown.frame(1.5, ["robot"]).details["robot"].cause
    report = statistics(chains_of_records([record]), house())
    assert report.shielded == (("Straight", "Around", 1),)
    assert "the shield replaced the policy's action at 1 of 3 decisions: Straight by Around 1 time" in as_text(report)


def test_a_record_of_a_shield_explains_and_replays_without_the_file(folder):
    path = folder / "run.mcap"
    driven(folder, record=path)
    for name in ("robot.toml", "house.npz"):
        (folder / name).unlink()
    run = rebuilt(Record(path), folder / "laid")
    assert run.ensembles["robot"].controller.policy.avoid == "position = stairs"
    assert replay(Record(path), run.actors).same
    assert WHY in asyncio.run(recorded_run(path).explain("robot", 1.5)).text


def test_a_record_of_a_program_holds_the_shield(folder):
    safe = mdm.shield(WRONG, house(), avoid="position = stairs", keep="reach position = goal")
    robot = mdm.Ensemble("robot", policy=safe, model=house(), actions=dict.fromkeys(ACTIONS, lambda: None))

    async def drive(runtime):
        await runtime.start(robot)
        for state in range(3):
            robot.publish_state(state)
            await asyncio.sleep(1)

    run_virtual(drive, record=folder / "program.mcap")
    record = Record(folder / "program.mcap")
    assert not record.cannot
    assert [each.message.wanted for each in record.messages(["decisions"])] == [None, 2, None]
    assert replay(record, rebuilt(record, folder / "laid").actors).same
    assert WHY in asyncio.run(recorded_run(record.path).explain("robot", 1.5)).text


@pytest.mark.parametrize("margin", [[], [("start", "safe", "good")]])
def test_a_record_of_a_program_holds_the_shield_of_a_policy_over_beliefs(folder, margin):
    moves = {("start", "safe"): "good", ("start", "risky"): {"good": 0.5, "pit": 0.5}}
    model = mdm.POMDP.from_functions(
        ["start", "good", "pit"],
        ["safe", "risky"],
        ["seen"],
        transition=lambda state, action: moves.get((state, action), state),
        observation=lambda action, state: "seen",
        reward=lambda state, action: float((state, action) == ("start", "risky")),
        discount=0.9,
        initial="start",
    )
    safe = mdm.shield(
        AlphaVectors([[1, 0, 0], [0, 0, 0]], [1, 0]), model, avoid="pit", keep="reach good", margin=margin
    )
    robot = mdm.Ensemble("robot", policy=safe, model=model, actions=dict.fromkeys(["safe", "risky"], lambda: None))

    async def drive(runtime):
        await runtime.start(robot)
        await asyncio.sleep(1)

    run_virtual(drive, record=folder / "program.mcap")
    record = Record(folder / "program.mcap")
    assert not record.cannot
    assert replay(record, rebuilt(record, folder / "laid").actors).same
    told = asyncio.run(recorded_run(record.path).explain("robot", 0.5)).text
    assert "The policy wanted 'risky', which may lead to pit: next good (0.5), pit (0.5)" in told


BUDGETS = ["probability = 0.3", "probability = 0.1", 'probability = 0.1, keep = "reach position = goal"']


@pytest.mark.parametrize("by", ["file", "program"])
@pytest.mark.parametrize("budget", BUDGETS)
def test_a_record_of_a_budget_explains_and_replays_it(folder, by, budget):
    options = f'avoid = "position = stairs", {budget}'
    system = load_system(written(folder, f"shield = {{ {options} }}"))
    safe = system.ensembles["robot"].controller.policy
    program = mdm.Ensemble("robot", policy=safe, model=house(), actions=dict.fromkeys(ACTIONS, lambda: None))
    told = {}

    async def drive(runtime):
        await runtime.start(system if by == "file" else program)
        for place in ("home", "landing", "hall", "landing", "home", "landing"):
            if by == "file":
                stand(system, place)
            else:
                program.publish_state(STATES.index(place))
            await asyncio.sleep(1)
            told[runtime.now() / 1e9] = str(runtime.explain("robot"))

    run_virtual(drive, record=folder / "run.mcap")
    for name in ("robot.toml", "house.npz"):
        (folder / name).unlink()
    record = Record(folder / "run.mcap")
    assert not record.cannot
    decisions = [each.message for each in record.messages(["decisions"])]
    assert decisions[1].wanted == (None if budget == BUDGETS[0] else 2)
    assert decisions[3].wanted == 2
    run = rebuilt(record, folder / "laid")
    again = run.ensembles["robot"].controller.policy
    assert (again.probability, again.keep, again.avoid) == (safe.probability, safe.keep, safe.avoid)
    assert replay(record, run.actors).same
    for at, words in told.items():
        assert asyncio.run(recorded_run(record.path).explain("robot", at - 0.5)).text == words


OVER_BELIEFS = """
[ensembles.robot]
model = "tiger.npz"
policy = "opens.npz"
shield = { avoid = "eaten", keep = "reach free" }
actions = { listen = "house_drives:wait", left = "house_drives:around", right = "house_drives:straight" }
"""


@pytest.mark.parametrize("by", ["file", "program"])
@pytest.mark.parametrize("kind", ["alpha vectors", "controller"])
def test_a_record_of_a_shield_by_supports_explains_and_replays_it(folder, by, kind):
    model = tiger()
    opens = {"alpha vectors": AlphaVectors([[0.0] * 4], [1], 3), "controller": FiniteStateController([1], [[0] * 5], 3)}
    save_model(model, folder / "tiger.npz")
    save_policy(opens[kind], folder / "opens.npz")
    (folder / "house_drives.py").write_text(CODE)
    (folder / "robot.toml").write_text(OVER_BELIEFS)
    safe = mdm.shield(opens[kind], model, avoid="eaten", keep="reach free")
    actions = dict.fromkeys(["listen", "left", "right"], lambda: None)
    robot = mdm.Ensemble("robot", policy=safe, model=model, actions=actions)
    system = load_system(folder / "robot.toml") if by == "file" else robot
    robot = system.ensembles["robot"] if by == "file" else robot
    told = {}

    async def drive(runtime):
        await runtime.start(system)
        for seen in ("nothing", "nothing", "tiger left"):
            await asyncio.sleep(1)
            robot.publish_observation(seen)
            told[runtime.now() / 1e9] = str(runtime.explain("robot"))

    run_virtual(drive, record=folder / "run.mcap")
    for name in ("robot.toml", "tiger.npz", "opens.npz"):
        (folder / name).unlink()
    record = Record(folder / "run.mcap")
    assert not record.cannot
    decisions = [each.message for each in record.messages(["decisions"])]
    assert [(each.action, each.wanted, each.wanted_name) for each in decisions] == [(0, 1, "left")] * 3 + [
        (2, 1, "left")
    ]
    run = rebuilt(record, folder / "laid")
    again = run.ensembles["robot"].controller.policy
    assert (type(again), again.keep, again.avoid) == (type(safe), safe.keep, safe.avoid)
    assert replay(record, run.actors).same
    for at, words in told.items():
        assert "The policy wanted 'left', which may lead to eaten" in words
        assert asyncio.run(recorded_run(record.path).explain("robot", at + 0.5)).text == words


def test_a_replay_with_a_shield_of_another_kind_wants_something_else(folder):
    path = folder / "run.mcap"
    driven(folder, record=path, policy=(2, 1, 2, 0, 0))  # around the landing by itself
    found = replay(Record(path), load_system(written(folder)))  # as its shield now has it go
    assert [each.fields for each in found.differences] == [("wanted",)]
    assert "wanted None, now 'Straight'" in found.differences[0].describe(0)


def test_the_digest_holds_the_shield(folder):
    digests = {
        load_system(written(folder, shield)).ensembles["robot"].controller.digests()["policy"]
        for shield in ("", SHIELD, 'shield = { avoid = "position = hall" }')
    }
    assert len(digests) == 3


_STAIRS = 'avoid = "position = stairs", '
SHIELDS = {
    'avoid = "position = hall"': {"landing": "Straight", "home": "Straight"},
    f'{_STAIRS}keep = "reach position = goal"': {"landing": "Around", "home": "Straight"},
    f'{_STAIRS}keep = "reach position = home"': {"landing": "Wait", "home": "Straight"},
    f"{_STAIRS}resolve = true": {"landing": "Around", "home": "Straight"},
    f"{_STAIRS}probability = 0.3, resolve = true": {"landing": "Straight"},
    f"{_STAIRS}probability = 0.1, resolve = true": {"landing": "Around"},
    f'{_STAIRS}keep = "reach position = goal", margin = [["hall", "Wait", "stairs"]]': {"landing": "Around"},
    f'{_STAIRS}keep = "reach position = landing", margin = [["hall", "Straight", "stairs"]]': {"hall": "Around"},
}
"""What the robot does in some states, by the options of its shield."""


@pytest.mark.parametrize("options", SHIELDS)
def test_each_option_decides(folder, options):
    policy = load_system(written(folder, f"shield = {{ {options} }}")).ensembles["robot"].controller.policy
    budget = policy.probability
    done = {name: policy.action(Budgeted(place, budget) if budget else place) for place, name in enumerate(STATES)}
    assert {state: ACTIONS[done[state]] for state in SHIELDS[options]} == SHIELDS[options]


@pytest.mark.parametrize(
    "options",
    [
        "",
        'avoid = "position = stair"',
        'avoid = "position = stairs"',
        'avoid = "(position = stairs"',
        'avoid = "position = home"',
        'avoid = "position = landing or position = hall", keep = "reach position = goal"',
        'avoid = "position = stairs", keep = "goal"',
        'avoid = "position = stairs", margin = [["landing", "Jump", "stairs"]]',
        'avoid = "position = stairs", margin = [["landing", "stairs"]]',
        'avoid = "position = stairs", probability = 1.5',
        'avoids = "position = stairs"',
    ],
)
def test_a_shield_that_means_nothing_or_stops_the_robot_is_refused_with_its_key(folder, options):
    with refused(ConfigError) as told:
        load_system(written(folder, f"shield = {{ {options} }}"))
    assert "robot.toml: ensembles.robot.shield" in str(told.value)


def test_a_shield_needs_a_model(folder):
    path = written(folder)
    path.write_text(path.read_text().replace('model = "house.npz"\n', ""))
    with refused(ConfigError):
        load_system(path)


def test_a_policy_that_is_code_is_not_run_to_look_at_its_shield(folder):
    path = written(folder, policy="POLICY")
    path.write_text(path.read_text().replace("['P', 'O', 'L', 'I', 'C', 'Y']", '"house_drives:policy"'))
    (folder / "house_drives.py").write_text((folder / "house_drives.py").read_text() + CODE_POLICY)
    assert not hasattr(look_over(path).ensembles["robot"].controller.policy, "avoid")
    assert load_system(path).ensembles["robot"].controller.policy.avoid == "position = stairs"


CODE_POLICY = """

def policy(model):
    return [2, 2, 2, 0, 0]
"""


JOINT = """shield = { avoid = 'room_a = lab and room_b = lab and action = "go go"' }"""


@pytest.mark.parametrize("mode", ["replicated", "centralised"])
def test_the_agents_of_a_team_decide_the_same_behind_a_shield(tmp_path, monkeypatch, mode):
    monkeypatch.syspath_prepend(tmp_path)
    mode_of = f'port = 7600\nmode = "{mode}"' + ('\ncontroller = "a"' if mode == "centralised" else "")
    path = team_file.write(
        tmp_path, ("policy = [0, 1, 2, 3]", f"policy = [0, 1, 2, 3]\n{JOINT}"), ("port = 7600", mode_of)
    )

    async def main():
        async with team_file.running(path) as (systems, _):
            told = {name: [] for name in systems}
            await asyncio.sleep(1)
            for name, system in systems.items():
                system.ensembles["joint"].channel("action", Action).subscribe(told[name].append)
            for system in systems.values():
                system.predicates.sense("InLab", True)
                await asyncio.sleep(1)
            return {name: [(each.index, each.wanted) for each in actions] for name, actions in told.items()}

    done = mdm.run(main, virtual=True)
    assert done["a"][-1] == (0, 3)
    assert [index for index, _ in done["b"]] == [index for index, _ in done["a"]]
    assert done["b"] == done["a"] if mode == "replicated" else done["b"][-1] == (0, None)


def test_an_agents_own_part_of_a_joint_policy_has_no_shield(tmp_path):
    path = team_file.write(tmp_path, ("policy = [0, 1, 2, 3]", f"policy = [0, 1, 2, 3]\nlocal = true\n{JOINT}"))
    with refused(ConfigError):
        load_system(path, agent="a")
