"""Chains of an ensemble from records: several runs, restarts, stops, torn files, and whether the model is right."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from estimated import nothing, ran as recorded_run
from records import Writing, decision, written
from sentences import refused

from mdm import Ensemble, ModelError, Runtime, World, run
from mdm.estimation import as_text, chains_of_records, check_names, open_records, statistics
from mdm.messages import Mode
from mdm.models import MDP
from mdm.policies import AlphaVectors
from mdm.problems import tiger
from mdm.recording import Record

MODEL = MDP([[[0.9, 0.1], [0.3, 0.7]]], np.zeros((2, 1)), discount=0.9, states=["dry", "wet"], actions=["go"])
MS = 1_000_000


def told(*epochs, **fields):
    return [("decisions", decision(number, **fields)) for number in epochs]


def records(tmp_path, *contents):
    return [written(tmp_path / f"{place}.mcap", each) for place, each in enumerate(contents)]


def ran(path, **options):
    return recorded_run(path, MODEL, **options)


def test_chains_are_those_of_the_decisions_as_they_were_made(tmp_path):
    path = tmp_path / "run.mcap"
    decisions = ran(path)
    chains = chains_of_records([Record(path)])
    assert [each.epoch for chain in chains.chains for each in chain.decisions] == [each.epoch for each in decisions]
    assert (chains.ensemble, chains.kind, chains.hidden) == ("robot", "jumps", False)
    *ended, last = chains.stays()
    assert all(stay.seconds == 3 and stay.ended for stay in ended)
    assert (last.seconds, last.ended) == (3.0, False)  # cut short when it stopped, and not at the record's end


def test_what_a_simulated_world_has_paid_is_told_beside_what_the_model_expected(tmp_path):
    """The model in use expects 1 for each decision in `dry`, where the world pays 3."""
    path = tmp_path / "run.mcap"
    names = {"discount": 0.9, "states": ["dry", "wet"], "actions": ["go"]}
    used, true = (MDP([MODEL.transition_matrix(0)], [[pay], [0.0]], **names) for pay in (1.0, 3.0))

    async def main():
        async with Runtime(record=path, log=False) as runtime:
            robot = Ensemble("robot", policy=[0, 0], model=used, actions={"go": lambda: None}, horizon=20)
            await runtime.start(World(robot, true, seed=1, period=1.0, finished=returns.append))
            await runtime.start(robot)
            await runtime.clock.sleep(99.5)

    returns = []
    run(main, virtual=True)
    report = statistics(chains_of_records([Record(path)]), used)
    assert report.paid[: len(returns)] == pytest.approx(returns)
    assert report.paid == pytest.approx([3 * each for each in report.returns])
    assert "as the simulated world has paid" in as_text(report)
    plain = tmp_path / "plain.mcap"
    ran(plain)
    assert statistics(chains_of_records([Record(plain)]), MODEL).paid == ()


def test_in_a_simulated_world_decisions_are_steps(tmp_path):
    path = tmp_path / "run.mcap"
    decisions = ran(path, world=True)
    chains = chains_of_records([Record(path)])
    assert chains.kind == "steps"
    assert len(list(chains.stays())) == len(decisions) - 1


def test_several_runs_are_counted_together_and_nothing_goes_from_one_into_the_next(tmp_path):
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    decisions = ran(first), ran(second, seconds=12)
    together = chains_of_records(open_records([first, second]))
    assert together.decisions == sum(map(len, decisions))
    assert len(together.chains) == 2
    assert sum(stay.seconds for stay in together.stays()) == 42


@pytest.mark.parametrize("drive", ["event", 1.0])
def test_false_negatives_are_refused_where_events_make_decisions(tmp_path, drive):
    """No file of a model has them: the record alone knows that they were declared."""
    path = tmp_path / "run.mcap"

    async def main():
        async with Runtime(record=path, log=False) as runtime:
            robot = Ensemble(
                "robot",
                policy=AlphaVectors([[1.0, 1.0]], [0], num_actions=3),
                model=tiger(),
                actions=dict.fromkeys(range(3), nothing),
                drive=drive,
                false_negative="hear-left",
            )
            await runtime.start(robot)
            for _ in range(3):
                robot.publish_observation("hear-right")
                await runtime.clock.sleep(1)

    run(main, virtual=True)
    if drive == "event":
        with refused(ModelError):
            chains_of_records([Record(path)])
    else:
        assert chains_of_records([Record(path)]).decisions == 3


def test_a_restart_and_a_safe_mode_break_chains(tmp_path):
    modes = [
        ("modes", Mode(time=4 * MS, ensemble="patrol", mode="safe", since=3 * MS + MS // 2)),
        ("modes", Mode(time=4 * MS, ensemble="other", mode="safe", since=MS)),
    ]
    again = [("decisions", decision(7, epoch=0, cause="start")), ("decisions", decision(8, epoch=1))]
    (path,) = records(tmp_path, [*told(0, 1, 2, 3), *modes, *again])
    chains = chains_of_records(open_records([path]))
    assert [len(chain.decisions) for chain in chains.chains] == [4, 2]
    assert [chain.end for chain in chains.chains] == [3 * MS + MS // 2, 8 * MS]


def test_lost_decisions_break_chains(tmp_path):
    (path,) = records(tmp_path, told(0, 1, 4, 5))
    assert [len(chain.decisions) for chain in chains_of_records(open_records([path])).chains] == [2, 2]


def test_a_torn_record_counts_to_its_tear(tmp_path):
    path = tmp_path / "whole.mcap"
    decisions = ran(path, seconds=300)
    torn = tmp_path / "torn.mcap"
    data = path.read_bytes()
    torn.write_bytes(data[: len(data) - 2_000])
    (record,) = open_records([torn])
    assert record.torn is not None
    assert 0 < chains_of_records([record]).decisions <= len(decisions)


def test_the_files_of_a_split_record_are_counted_once_in_any_order(tmp_path):
    writing = Writing(tmp_path / "run.mcap", split_seconds=0.01)
    for topic, message in told(*range(60)):
        writing.write(topic, message)
        writing.writer.flush()
    writing.close()
    files = sorted(tmp_path.glob("run*.mcap"))
    assert len(files) > 2
    for given in (files, files[::-1], [tmp_path / "run.mcap", tmp_path / "run.mcap"]):
        opened = open_records(given)
        assert len(opened) == 1
        assert chains_of_records(opened).decisions == 60


def test_a_run_given_twice_is_refused(tmp_path):
    (path,) = records(tmp_path, told(0, 1))
    shutil.copyfile(path, tmp_path / "copy.mcap")
    with refused(ModelError):
        open_records([path, tmp_path / "copy.mcap"])


def test_an_ensemble_is_named_where_several_have_decided(tmp_path):
    (path,) = records(tmp_path, [*told(0, 1), *told(0, ensemble="top")])
    opened = open_records([path])
    assert chains_of_records(opened, "patrol").decisions == 2
    with refused(ModelError):
        chains_of_records(opened)
    with refused(ModelError):
        chains_of_records(opened, "tpo")


def test_the_end_of_a_path_pools_robots_and_what_is_not_counted_is_named(tmp_path):
    first, second, third = records(
        tmp_path,
        [*told(0, 1, ensemble="ada/robot"), *told(0, ensemble="ada/top")],
        told(0, 1, 2, ensemble="bob/robot"),
        told(0, 1, ensemble="autorobot"),
    )
    opened = open_records([first, second, third])
    pooled = chains_of_records(opened, "robot")
    assert (pooled.ensemble, [len(chain.decisions) for chain in pooled.chains]) == ("robot", [2, 3])
    assert pooled.unused == (f"{first}: ada/top", f"{third}: autorobot")
    assert chains_of_records(opened, "ada/robot").unused[1] == f"{second}: bob/robot"
    report = statistics(pooled, MDP([np.full((3, 3), 1 / 3)] * 2, np.zeros((3, 2)), discount=0.9))
    assert f"not counted: {third}: autorobot" in report.notes


def test_runs_in_which_it_has_not_decided_count_for_nothing(tmp_path):
    first, second = records(tmp_path, told(0, 1), [])
    assert chains_of_records(open_records([first, second])).decisions == 2
    with refused(ModelError):
        chains_of_records(open_records([second]))


def test_runs_that_decide_otherwise_are_not_counted_together(tmp_path):
    ticks = [("decisions", decision(number, cause="tick")) for number in range(3)]
    first, second = records(tmp_path, told(0, 1, 2), ticks)
    with refused(ModelError):
        chains_of_records(open_records([first, second]))


@pytest.mark.parametrize(
    "other",
    [
        {"states": ["dry", "damp"]},
        {"actions": ["run"]},
        {"transitions": [np.eye(3)], "rewards": np.zeros((3, 1)), "states": ["a", "b", "c"]},
    ],
)
def test_a_model_of_other_names_is_refused_with_the_first_difference(tmp_path, other):
    path = tmp_path / "run.mcap"
    ran(path, seconds=6)
    record = Record(path)
    check_names([record], "robot", MODEL)
    given = {"transitions": [np.eye(2)], "rewards": np.zeros((2, 1)), "states": ["dry", "wet"], "actions": ["go"]}
    given |= other
    model = MDP(given.pop("transitions"), given.pop("rewards"), discount=0.9, **given)
    with refused(ModelError):
        check_names([record], "robot", model)


def test_a_record_without_names_is_no_difference(tmp_path):
    (path,) = records(tmp_path, told(0, 1))
    assert not Record(path).metadata.keys() - {"mdm", "mdm.file", "mdm.end"}
    check_names([Record(path)], "patrol", MODEL)
