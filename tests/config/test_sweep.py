"""Sweeps: tables of points, entries of models, rows by hand, journals that are torn, and the same rows by whoever."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from places import ROOT, TIGER
from sentences import refused
from worked import Shuffled

import mdm
from mdm import ConfigError, FormatError, ModelError
from mdm.config.sweep import planned, points_of, read_journal, sweep, with_entry
from mdm.config.tables import Problems
from mdm.models.digest import digest
from mdm.simulation import parts

WALK = {"model": "swept:walk", "vary": {"slip": {"from": 0.1, "to": 0.4, "step": 0.1}, "discount": [0.8, 0.9]}}


@pytest.fixture(autouse=True)
def _here(monkeypatch):
    monkeypatch.chdir(ROOT / "tests")


def without_run(rows):
    """Return rows as bytes, without what differs from run to run."""
    kept = [{name: value for name, value in row.items() if not name.startswith("run.")} for row in rows]
    return json.dumps(kept).encode()


# -- Points ------------------------------------------------------------------------------------------------------------


def points(vary):
    found = Problems(None)
    made = points_of(vary, found)
    found.raise_all()
    return made


values = st.lists(st.sampled_from([1, -2, 0.5, "one", True, [1, "two"]]), min_size=1, max_size=3)


@given(st.dictionaries(st.sampled_from("abcd"), values, min_size=1, max_size=3))
def test_points_are_all_combinations_the_last_parameter_first(vary):
    expected = [dict(zip(vary, each, strict=True)) for each in itertools.product(*vary.values())]
    assert points(vary) == expected


@given(st.integers(-50, 50), st.integers(0, 30), st.integers(1, 7))
def test_a_range_has_its_ends(first, width, step):
    assert points({"a": {"from": first, "to": first + width}}) == [{"a": first + each} for each in range(width + 1)]
    stepped = [each["a"] for each in points({"a": {"from": first, "to": first + width, "step": step}})]
    assert stepped == [*range(first, first + width + 1, step)]
    assert all(type(each) is int for each in stepped)
    few = [each["a"] for each in points({"a": {"from": first, "to": first + width + 0.5, "count": step + 1}})]
    assert few == pytest.approx(np.linspace(first, first + width + 0.5, step + 1))


def test_steps_of_tenths_reach_the_end():
    assert [each["a"] for each in points({"a": {"from": 0.0, "to": 0.3, "step": 0.1}})] == pytest.approx(
        [0, 0.1, 0.2, 0.3]
    )
    assert points({"a": {"from": 0, "to": 1, "count": 3}}) == [{"a": 0}, {"a": 0.5}, {"a": 1}]
    assert points({"a": "one", "b": [[1, 2]]}) == [{"a": "one", "b": [1, 2]}]


def test_draws_are_the_published_sequence_together():
    # P. Bratley and B. Fox, Algorithm 659, ACM Transactions on Mathematical Software 14, 1988: the first points
    made = points({"x": {"sobol": 4, "from": 0.0, "to": 1.0}, "n": [1, 2], "y": {"sobol": 4, "from": 0, "to": 7}})
    assert [(each["x"], each["y"]) for each in made[::2]] == [(0.0, 0), (0.5, 4), (0.75, 2), (0.25, 6)]
    assert [list(each) for each in made] == [["x", "y", "n"]] * 8
    apart = points({"x": {"sobol": 2, "from": 0.0, "to": 1.0}, "y": {"sobol": 4, "from": 0.0, "to": 1.0}})
    assert [(each["x"], each["y"]) for each in apart] == [*itertools.product([0.0, 0.5], [0.0, 0.5, 0.75, 0.25])]


@pytest.mark.parametrize(
    "given",
    [
        *([10**30], {"from": 1, "to": 10**30}, {"from": 1, "to": 10**400}, {"sobol": 10**30, "from": 0, "to": 1}),
        *([], [float("nan")], [None], [[1, {}]], {}, {"from": 1}, {"from": 1, "to": "2"}, {"from": 2, "to": 1}),
        *({"from": 0, "to": float("inf")}, {"from": 0.5, "to": 1}, {"from": 0, "to": 1, "step": 0}),
        *({"from": 0, "to": 1, "count": 1}, {"from": 0, "to": 1, "count": 2, "step": 1}, {"from": 0, "to": 10**7}),
        *({"from": 0, "to": 1, "steps": 2}, {"sobol": 10, "from": 0, "to": 1}, {"sobol": 4, "from": 0}),
        {"sobol": 4, "from": 0, "to": 1, "count": 4},
    ],
)
def test_what_is_no_parameter_is_refused_with_its_name(given):
    with refused(ConfigError) as caught:
        points({"slip": given})
    assert "vary.slip" in str(caught.value)


def test_more_than_a_million_points_are_refused():
    with refused(ConfigError):
        points({"a": {"from": 1, "to": 2000}, "b": {"from": 1, "to": 2000}})


# -- Entries -----------------------------------------------------------------------------------------------------------


@given(st.floats(0, 1), st.floats(0.05, 0.95))
def test_an_entry_changes_and_the_rest_keeps_its_proportions(value, slip):
    from swept import walk

    model = walk(slip)
    made = with_entry(model, "T.move.*.slip", value)
    expected = np.array([[1 - value, value, 0], [0, value, 1 - value], [0, 0, 1]])
    assert np.allclose(made.transition_matrix("move"), expected, atol=1e-12)
    assert np.array_equal(made.transition_matrix("wait"), model.transition_matrix("wait"))
    assert (made.discount, made.state_space) == (model.discount, model.state_space)
    rewarded = with_entry(made, "R.*.start", value)
    assert rewarded.rewards.tolist() == [[value, value], [0, 1], [0, 0]]


def test_entries_of_a_pomdp_are_those_of_its_file():
    tiger = mdm.load_model(TIGER)
    names = tiger.observation_space.names
    made = with_entry(tiger, f"O.listen.tiger-left.{names[0]}", 0.7)
    assert made.observation_matrix("listen").tolist()[0] == pytest.approx([0.7, 0.3])
    assert made.observation_matrix("listen").tolist()[1] == tiger.observation_matrix("listen").tolist()[1]
    assert np.array_equal(made.rewards, tiger.rewards)
    assert digest(with_entry(made, f"O.listen.tiger-left.{names[0]}", 0.85)) != digest(made)


def test_rewards_of_outcomes_follow_their_entries():
    rewards = np.zeros((1, 2, 2))
    rewards[0, 0, 1] = 10
    model = mdm.MDP([[[0.5, 0.5], [0, 1]]], rewards, discount=0.9)
    assert with_entry(model, "T.0.0.1", 0.25).rewards.tolist() == [[2.5], [0]]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("T.move.start", 0.1), ("T.fly.start.slip", 0.1), ("T.move.*.nowhere", 0.1), ("T.move.x*.slip", 0.1)),
        *(("T.move.start.slip", 1.5), ("T.move.start.*", 0.6), ("T.wait.start.start", 0.5), ("O.move.start.x", 0.5)),
    ],
)
def test_what_is_no_entry_is_refused_with_its_name(key, value):
    from swept import walk

    with refused(ModelError) as caught:
        with_entry(walk(0.2), key, value)
    assert key in str(caught.value)


def test_observed_factors_have_no_entries_to_name():
    with refused(ModelError):
        with_entry(mdm.problems.tag(), "T.*.*.*", 0.5)


# -- Rows --------------------------------------------------------------------------------------------------------------


def test_a_row_is_what_solving_and_evaluating_by_hand_give():
    from swept import walk

    plan = {**WALK, "evaluate": {"episodes": 50, "steps": 30, "seed": 3, "metrics": ["swept:sure"]}}
    plan["vary"] = {**WALK["vary"], "solve.gap": [0.1]}
    rows = sweep(plan)
    assert [row["point"] for row in rows] == [*range(8)]
    for row in rows:
        model = walk(row["slip"]).with_discount(row["discount"])
        solution = mdm.solve(model, gap=0.1)
        result = mdm.evaluate(model, solution.policy, episodes=50, steps=30, seed=3)
        assert (row["lower"], row["upper"], row["reason"]) == (solution.lower, solution.upper, solution.reason)
        assert (row["value"], row["standard_error"], row["episodes"]) == (result.mean, result.standard_error, 50)
        assert (row["model"], row["seed"], row["failure"]) == (digest(model), 3, None)
        assert row["swept:sure"] == pytest.approx(1 - row["slip"])
    assert len({row["policy"] for row in rows}) > 1


def test_what_is_known_exactly_is_not_simulated():
    (row,) = sweep({"model": "swept:walk", "vary": {"slip": 0.25}, "evaluate": {"seed": 2}})
    value = -0.1 / (1 - 0.9 * 0.25) + 0.9 * 0.75 / (1 - 0.9 * 0.25) * 1 / (1 - 0.9 * 0.25)
    assert row["value"] == pytest.approx(value, abs=1e-3)
    assert (row["standard_error"], row["episodes"]) == (0.0, None)
    (few,) = sweep({"model": "swept:walk", "vary": {"slip": 0.25}, "evaluate": {"steps": 2}})
    assert few["value"] == pytest.approx(-0.1 + 0.9 * (0.75 * 1 - 0.25 * 0.1))


def test_a_models_file_its_durations_and_the_solver_vary(tmp_path):
    from swept import walk

    mdm.save_model(walk(0.2), tmp_path / "walk.npz")
    mdm.formats.save_durations(mdm.models.Durations([[1.0, 2.0]] * 3, of="step"), tmp_path / "times.npz")
    vary = {"durations.move": [2.0, 4.0], "solve.solver": ["value-iteration", "policy-iteration"], "R.move.slip": 2}
    (tmp_path / "sweep.toml").write_text(
        'model = "walk.npz"\ndurations = "times.npz"\n[vary]\n'
        + "\n".join(f'"{name}" = {json.dumps(value)}' for name, value in vary.items())
    )
    rows = sweep(tmp_path / "sweep.toml")
    assert [row["solver"] for row in rows] == ["value-iteration", "policy-iteration"] * 2
    for row in rows:
        durations = mdm.models.Durations([[1.0, row["durations.move"]]] * 3, of="step")
        model = with_entry(walk(0.2), "R.move.slip", 2)
        solution = mdm.solve(model, row["solve.solver"], durations=durations)
        assert row["lower"] == solution.lower
    assert rows[0]["value"] > rows[2]["value"]


def test_a_point_that_fails_is_a_row_that_says_why():
    plan = {**WALK, "vary": {"slip": [0.1, 0.3, 0.5, 2]}, "evaluate": {"metrics": ["swept:wrong"]}}
    rows = sweep(plan)
    assert [row["failure"] and row["failure"].partition(":")[0] for row in rows] == [
        "swept",
        None,
        "ValueError",
        rows[3]["failure"].partition(":")[0],
    ]
    assert rows[1]["swept:wrong"] == pytest.approx(0.3)
    assert rows[0]["value"] is None


def test_all_points_have_the_same_random_numbers():
    plan = {"model": "swept:walk", "vary": {"slip": [0.3, 0.3]}, "evaluate": {"episodes": 20}}
    first, second = sweep(plan)
    assert (first["value"], first["standard_error"]) == (second["value"], second["standard_error"])
    assert first["standard_error"] > 0


def test_progress_ends_a_sweep_with_what_has_ended(tmp_path):
    rows = sweep(WALK, tmp_path / "j", progress=lambda ended, count: (ended, count) == (3, 8))
    assert [row["point"] for row in rows] == [0, 1, 2]
    whole = sweep(WALK, tmp_path / "j", resume=True)
    assert without_run(whole) == without_run(sweep(WALK))
    assert whole[:3] == rows


# -- Files -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given",
    [
        *({}, {"problem": "tiger"}, {"problem": "tigre", "vary": {"a": 1}}, {"vary": {"a": 1}}),
        *({"problem": "tiger", "vary": {"acuracy": 1}}, {"problem": "tiger", "vary": {"x": 1}}),
        *({"problem": "tiger", "vary": {"seed": 1}}, {"problem": "tiger", "vary": {"discount": 1}, "sovle": {}}),
        *({**WALK, "problem": "tiger"}, {**WALK, "model": "absent:walk"}, {**WALK, "model": "swept:absent"}),
        *({**WALK, "model": "absent.pomdp"}, {**WALK, "durations": "absent.npz"}, {**WALK, "vary": {"T.a": ["b"]}}),
        *({**WALK, "solve": {"tme": 1}}, {**WALK, "solve": {"solver": "x"}}, {**WALK, "solve": {"gap": "x"}}),
        *({**WALK, "evaluate": {"episodes": 0}}, {**WALK, "evaluate": {"metric": 0}}, {**WALK, "vary": 3}),
        {**WALK, "evaluate": {"metrics": ["absent:one", "swept:absent", "swept"]}},
    ],
)
def test_a_wrong_file_is_refused_with_the_key(given):
    with refused(ConfigError):
        planned(given)


def test_a_file_that_is_no_toml_is_refused(tmp_path):
    for number, data in enumerate((b"a =", b"\x89PNG")):
        path = tmp_path / f"{number}.toml"
        path.write_bytes(data)
        with refused(FormatError):
            planned(path)


# -- Journals ----------------------------------------------------------------------------------------------------------


def test_what_has_ended_is_not_done_again(tmp_path, monkeypatch):
    journal = tmp_path / "j.jsonl"
    rows = sweep(WALK, journal)
    lines = journal.read_bytes()
    monkeypatch.setattr("mdm.config.sweep.solve", None)
    assert sweep(WALK, journal, resume=True) == rows
    assert journal.read_bytes() == lines
    with refused(FormatError):
        sweep(WALK, journal)
    with refused(FormatError):
        sweep({**WALK, "evaluate": {"seed": 2}}, journal, resume=True)
    journal.write_bytes(lines.replace(mdm.__version__.encode(), b"0.0.1", 1))
    with refused(FormatError):
        sweep(WALK, journal, resume=True)
    journal.write_bytes(lines.replace(b'{"point":3', b'{"paint":3'))
    with refused(FormatError):
        sweep(WALK, journal, resume=True)
    (tmp_path / "other").write_bytes(b"one\ntwo\n")
    with refused(FormatError):
        sweep(WALK, tmp_path / "other")
    with refused(FormatError):
        sweep(WALK, tmp_path / "absent" / "j")


@pytest.mark.parametrize(
    "data", [b'{"mine": 1}\n', b'{"mine": 1}', b"notes", b'{"sweep":"a","version":"b"}\n{"point":0}\n']
)
def test_a_file_that_is_no_journal_is_left_as_it_is(tmp_path, data):
    journal = tmp_path / "j.jsonl"
    journal.write_bytes(data)
    for resume in (False, True):
        with refused(FormatError):
            sweep(WALK, journal, resume=resume)
    assert journal.read_bytes() == data


def test_a_journal_is_of_one_sweep_at_a_time(tmp_path):
    journal = tmp_path / "j.jsonl"
    plan = {"model": "swept:walk", "vary": {"slip": [0.1, 0.2]}}

    def second(ended, _):
        if ended == 1:
            with pytest.raises(FormatError, match="another sweep writes this journal"):
                sweep(plan, journal, resume=True)

    rows = sweep(plan, journal, progress=second)
    assert sweep(plan, journal, resume=True) == rows


def test_other_code_of_users_is_told_of_points_that_keep_what_the_old_one_gave(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    code = tmp_path / "measures_of_sweeps.py"
    code.write_text("def one(model, policy):\n    return 1\n")
    (tmp_path / "s.toml").write_text(
        'model = "swept:walk"\nvary.slip = [0.1, 0.2]\nevaluate.metrics = ["measures_of_sweeps:one"]\n'
    )
    rows = sweep(tmp_path / "s.toml", tmp_path / "j")
    assert sweep(tmp_path / "s.toml", tmp_path / "j", resume=True) == rows
    code.write_text("def one(model, policy):\n    return 2\n")
    with pytest.warns(UserWarning, match="has changed since 2 points ended"):
        assert sweep(tmp_path / "s.toml", tmp_path / "j", resume=True) == rows


def test_what_failed_is_tried_once_more(tmp_path, monkeypatch):
    plan = {"model": "swept:walk", "vary": {"slip": [0.3, 0.5]}, "evaluate": {"metrics": ["swept:wrong"]}}
    journal = tmp_path / "j"
    assert [row["failure"] is None for row in sweep(plan, journal)] == [True, False]
    monkeypatch.setattr("swept.wrong", lambda model, policy: 1)
    with pytest.warns(UserWarning, match="has changed since 1 point ended"):
        assert [row["failure"] for row in sweep(plan, journal, resume=True)] == [None, None]
    assert [row["point"] for row in map(json.loads, journal.read_text().splitlines()[1:])] == [0, 1, 1]
    assert read_journal(journal)[1][1]["swept:wrong"] == 1


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    journal = tmp_path_factory.mktemp("whole") / "j"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT / "tests")
        return sweep(WALK, journal), journal.read_bytes()


@given(share=st.floats(0, 1))
def test_a_journal_that_is_torn_anywhere_goes_on(whole, tmp_path_factory, share):
    rows, data = whole
    journal = tmp_path_factory.mktemp("torn") / "j"
    journal.write_bytes(data[: int(share * len(data))])
    assert without_run(sweep(WALK, journal, resume=True)) == without_run(rows)
    assert without_run(read_journal(journal)[1][number] for number in range(8)) == without_run(rows)
    assert journal.read_bytes().startswith(data[: int(share * len(data))].rpartition(b"\n")[0])


# -- Workers -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 2])
def test_the_same_rows_whoever_ran_them_in_any_order(whole, tmp_path, workers):
    rows, _ = whole
    with Shuffled(workers, seed=workers) as executor:
        found = sweep(WALK, tmp_path / "j", executor=executor)
    units = {(part.first, part.last) for part, *_ in executor.sent if isinstance(part, parts.Part)}
    assert units == {(point, point + 1) for point in range(8)}  # one may take hours, and is kept as soon as it ends
    assert without_run(found) == without_run(rows)
    assert without_run(sweep(WALK, tmp_path / "j", resume=True)) == without_run(rows)


def test_a_point_that_no_worker_ends_is_a_row_and_is_tried_once_more(whole, tmp_path):
    rows, _ = whole

    def changed(answer):
        if isinstance(answer, parts.Answer) and answer.result and answer.result[0]["point"] == 5:
            return parts.Answer(answer.worker, failure="lost")
        return answer

    with (
        Shuffled(1, changed=changed) as executor,
        pytest.warns(mdm.WorkerWarning, match="1 point of seed 0 is missing"),
    ):
        found = sweep(WALK, tmp_path / "j", executor=executor)
    assert [row["point"] for row in found if row["failure"]] == [5]
    assert without_run(sweep(WALK, tmp_path / "j", resume=True)) == without_run(rows)


@pytest.mark.slow
def test_the_same_rows_by_processes(whole):
    rows, _ = whole
    for number in (1, 2):
        with mdm.simulation.Processes(number) as workers:
            assert without_run(sweep(WALK, executor=workers)) == without_run(rows)


def test_the_name_of_a_sweep_is_public():
    assert mdm.sweep is sweep
    assert Path(sweep.__code__.co_filename).name == "sweep.py"
