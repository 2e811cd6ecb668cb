"""Parts in any order, on any workers, with failures: the same bytes, or what is missing is told."""

from __future__ import annotations

import itertools
import math
import warnings
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from unittest.mock import patch

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sentences import refused
from worked import Cautious, Frail, Once, Shuffled, without_mdm

import mdm
from mdm import ConfigError, Error, WorkerWarning
from mdm.policies import AlphaVectors, RandomPolicy
from mdm.problems import tiger
from mdm.simulation import Processes, batch, parts
from mdm.simulation.batch import EpisodeBatch, EpisodeRunner, limits, one_by_one
from mdm.simulation.parts import Answer, Part, run_part

VECTORS = AlphaVectors([[9, 9], [-90, 11], [11, -90]], [0, 1, 2])


EATEN = "tiger-left and action = open-left"


def evaluated(policy, executor=None, **options):
    return mdm.evaluate(tiger(), policy, **{"episodes": 45, "steps": 12, "seed": 3} | options, executor=executor)


def reached(policy, executor=None, **options):
    given = {"episodes": 45, "seed": 3, "until": "tiger-left and action = open-left within 20"} | options
    return mdm.evaluate(tiger(), policy, **given, executor=executor)


def simulated(policy, executor=None, **options):
    return mdm.simulate(tiger(), policy, **{"episodes": 25, "steps": 6, "seed": 3} | options, executor=executor)


def compared(policy, executor=None, **options):
    given = {"episodes": 45, "steps": 12, "seed": 3} | options
    found = mdm.compare(tiger(), [VECTORS, policy], **given, executor=executor)
    return msgspec.structs.replace(found.evaluations[1], mean=found.difference(1)[0])


def kept(result):
    """Return what is to be the same, as bytes."""
    return result.returns.tobytes(), result.mean, result.standard_error, result.moves, result.missing, result.seed


@settings(max_examples=12, deadline=None)
@given(
    st.sampled_from([evaluated, reached, simulated, compared]),
    st.sampled_from([VECTORS, Cautious(), RandomPolicy(3, 2)]),
    st.integers(1, 5),
    st.integers(0, 99),
    st.sampled_from([0.0, 0.002, 1.0]),
)
def test_parts_in_any_order_give_the_same_bytes(run, policy, workers, seed, long):
    with (
        patch.object(parts, "_LONG", long),
        patch.object(batch, "_FIRST", 5),
        patch.object(batch, "_CHUNK", 16),
        patch.object(batch, "_TOGETHER", 2),
        Shuffled(workers, seed) as executor,
    ):
        assert kept(run(policy, executor)) == kept(run(policy))


@pytest.mark.parametrize("run", [evaluated, simulated])
@pytest.mark.parametrize("count", [1, 7, 20])
def test_an_episode_is_the_same_whatever_others_there_are(run, count):
    for policy in (Cautious(), RandomPolicy(3, 2, seed=1)):
        with patch.object(RandomPolicy, "batch", lambda policy, model: None):
            assert np.array_equal(run(policy, episodes=count).returns, run(policy).returns[:count])


def test_an_evaluation_has_the_streams_that_a_seed_spawns():
    model = tiger()
    ends = limits(model, VECTORS, 12)
    run = EpisodeBatch(model, VECTORS.batch(model), ends, observed=True)
    streams = np.random.SeedSequence(3).spawn(2)
    first, then = (run(size, np.random.default_rng(each))[0] for size, each in zip((1000, 500), streams, strict=True))
    assert np.array_equal(evaluated(VECTORS, episodes=1500).returns, np.concatenate([first, then]))
    run, policy = EpisodeRunner(model, Cautious()), evaluated(Cautious(), episodes=5)
    for stream, value in zip(np.random.SeedSequence(3).spawn(5), policy.returns, strict=True):
        rewards = []
        for step in run(stream):
            rewards.append(model.rewards[step.state, step.action])
            if len(rewards) == 12:
                break
        assert math.fsum(each * model.discount**time for time, each in enumerate(rewards)) == pytest.approx(value)


def test_a_model_travels_once_to_each_worker_and_with_it_what_decides():
    with patch.object(parts, "_LONG", 0.0), Shuffled(3) as executor:
        for policy in (Cautious(), Once("/dev/null")):
            evaluated(policy, executor)
    sent = [arguments[1] for arguments in executor.sent if isinstance(arguments[0], Part)]
    assert len(sent) > 90
    digests = [digest for each in sent for digest in each]
    assert all(digests.count(digest) <= 20 for digest in digests)  # what is sent may meet a worker that has it
    with Shuffled() as executor:
        assert all(result.parts for result in evaluated(VECTORS, executor).workers)


def test_what_workers_lack_reaches_them_though_parts_change_between_them():
    turns = itertools.count()

    class Turns(Executor):
        """Each part, and each part that is sent again, goes to the other of two workers."""

        _max_workers = 1

        def submit(self, function, /, *arguments):
            turn = next(turns)
            assert turn < 20
            return pools[turn % 2].submit(function, *arguments)

    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(1) as two:
        pools = two, one
        evaluated(VECTORS, one)  # it has the model, and the other worker nothing
        assert kept(evaluated(Cautious(), Turns())) == kept(evaluated(Cautious()))


def test_a_part_that_fails_is_tried_once_more(tmp_path):
    with Shuffled() as executor:
        assert kept(evaluated(Once(tmp_path / "a"), executor)) == kept(evaluated(Cautious()))


def test_what_fails_twice_is_missing_and_told():
    model, ended = tiger(), []
    for episode in range(45):
        try:
            ended.append(
                float(one_by_one(model, Frail(), limits(model, Frail(), 4), episodes=1, seed=3, first=episode)[0][0])
            )
        except mdm.errors.PolicyError:
            ended.append(None)
    assert 0 < ended.count(None) < 45
    with patch.object(parts, "_LONG", 0.0), Shuffled(1) as executor, pytest.warns(WorkerWarning) as told:
        result = evaluated(Frail(), executor, steps=4)
    assert result.returns.tolist() == [each for each in ended if each is not None]
    assert result.missing == ended.count(None)
    assert f"and {result.missing} are missing" in repr(result)
    (text,) = [str(each.message) for each in told]
    assert text.startswith(
        f"{result.missing} episodes of seed 3 are missing, the first at spawn key ({ended.index(None)},): "
    )
    assert "too sure" in text
    pair = mdm.simulation.Comparison((evaluated(Cautious(), steps=4), result))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pair.difference(1)[0] == pytest.approx(result.mean - pair.evaluations[0].mean)


def test_a_work_that_fails_from_its_first_part_on_is_refused():
    class Broken(Cautious):
        pass

    Broken.__module__ = "nowhere"
    Broken.__qualname__ = "Broken"
    with Shuffled() as executor, pytest.raises(Error, match="no part has ended, 45 episodes of seed 3 are missing"):
        evaluated(Frail(0.4), executor)
    with Shuffled() as executor, refused(ConfigError):
        evaluated(Broken(), executor)


@pytest.mark.parametrize("run", [evaluated, simulated])
def test_who_is_told_of_progress_ends_it_with_what_is_known(run):
    whole, told = run(Cautious()), []
    with patch.object(parts, "_LONG", 0.0), Shuffled(2) as executor:
        part = run(Cautious(), executor, progress=lambda *counts: told.append(counts) or counts[0] >= 5)
    assert 5 <= part.episodes == told[-1][0] < told[-1][1] == whole.episodes
    assert set(part.returns) <= set(whole.returns)
    assert (part.missing, told[-1][1]) == (0, whole.episodes)


def test_hosts_that_differ_are_told():
    hosts = iter(range(10**6))

    def changed(answer):
        if not isinstance(answer, Answer) or not answer.seconds:
            return answer
        odd = next(hosts) % 2
        environment = answer.worker.environment | {"numpy": f"{odd}.0"}
        worker = msgspec.structs.replace(answer.worker, host="ab"[odd], environment=environment)
        return answer._replace(worker=worker)

    with patch.object(parts, "_LONG", 0.0), Shuffled(changed=changed) as executor, pytest.warns(WorkerWarning) as told:
        result = evaluated(Cautious(), executor)
    assert {worker.host for worker in result.workers} == {"a", "b"}
    assert sum(worker.parts for worker in result.workers) == 45
    (text,) = [str(each.message) for each in told]
    assert text.startswith("numpy differs among workers, ")
    assert "0.0 on a" in text
    assert "1.0 on b" in text


class Ending(Executor):
    """Ends after so many calls, with what is under way."""

    def __init__(self, calls):
        self._calls = calls

    def submit(self, function, /, *arguments):
        future = Future()
        self._calls -= 1
        if self._calls < 0:
            future.set_exception(BrokenExecutor("a worker was killed"))
        else:
            future.set_result(function(*arguments))
        return future


def test_an_executor_of_the_users_own_that_ends_leaves_what_is_missing_named():
    whole = evaluated(Cautious())
    with patch.object(parts, "_LONG", 0.0), pytest.warns(WorkerWarning, match="the executor has ended: a worker was"):
        result = evaluated(Cautious(), Ending(25))
    assert 0 < result.episodes == 45 - result.missing < 45
    later = iter(whole.returns)
    assert all(each in later for each in result.returns)


def test_what_cannot_run_is_refused_before_the_first_part():
    with Shuffled() as closed:
        pass
    with refused(ConfigError):
        evaluated(VECTORS, closed)
    with refused(ConfigError):
        evaluated(VECTORS, 2)
    with refused(ConfigError):
        simulated(VECTORS, closed, record="a.mcap")
    with Shuffled() as executor:
        with refused(ConfigError):
            simulated(VECTORS, executor, rewards=lambda: None)
        with patch.object(Cautious, "__module__", "__main__"), refused(ConfigError):
            evaluated(Cautious(), executor)
        with (
            patch.object(parts, "__version__", "0"),
            pytest.raises(ConfigError, match="but here it is 0: install the same"),
        ):
            evaluated(VECTORS, executor)
        with patch.object(parts, "resolve_name", without_mdm), pytest.raises(ConfigError, match="a worker has no mdm"):
            evaluated(VECTORS, executor)
    answer = run_part(Part(0, 1, ("a", "b"), version="0"), {})
    assert (answer.failure.startswith(f"{answer.worker.host} has mdm {mdm.__version__}, "), answer.result) == (
        True,
        None,
    )
    with refused(ConfigError):
        evaluated(VECTORS, Ending(0))


def test_a_policy_that_searches_is_told_with_its_bound():
    search = mdm.solvers.TreeSearch(tiger(), expansions=5, memory=2_000_000)
    search.action([0.5, 0.5])
    with (
        Shuffled() as executor,
        pytest.warns(WorkerWarning, match="by itself, 2 of them with up to 4 MB;"),
    ):
        result = evaluated(search, executor, episodes=4)
    assert kept(result) == kept(evaluated(search, episodes=4))


class Here(Processes):
    """Works in this process."""

    def submit(self, function, /, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future


def test_processes_that_search_with_more_memory_than_there_is_are_refused():
    search = mdm.solvers.TreeSearch(tiger(), expansions=5, memory=30_000_000)
    search = mdm.verification.shield(search, tiger(), avoid=EATEN)
    with Here(3) as executor, patch.object(parts, "free_memory", lambda: 80e6), refused(ConfigError):
        evaluated(search, executor)
    with Here(3) as executor, patch.object(parts, "free_memory", lambda: 90e6), pytest.warns(WorkerWarning):
        assert evaluated(search, executor, episodes=2).episodes == 2


def test_processes_that_were_killed_while_idle_start_again():
    class Idle(Here):
        broken = True

        def submit(self, function, /, *arguments):
            if self.broken:
                raise BrokenExecutor("a worker was killed")
            return super().submit(function, *arguments)

        def renew(self):
            self.broken = False

    with Idle(1) as executor:
        assert kept(evaluated(VECTORS, executor)) == kept(evaluated(VECTORS))


class Cluster(Shuffled):
    """An executor as Dask's: workers come and go, and each has a version."""

    def __init__(self, **versions):
        super().__init__()
        self._client, self.versions, self.named = self, versions, []

    def nthreads(self):
        return dict.fromkeys(self.versions, 1)

    def run(self, function, name, *, workers, on_error):
        return {worker: self.versions[worker] for worker in workers}

    def submit(self, function, /, *arguments, **named):
        self.named.append(named.get("workers"))
        return super().submit(function, *arguments)


def test_workers_of_another_version_are_refused_also_those_that_come_late():
    ours, none = mdm.__version__, ModuleNotFoundError("No module named 'mdm'")
    for versions in ({"a": ours, "b": "0"}, {"a": none}):
        with Cluster(**versions) as cluster, pytest.raises(ConfigError, match="but here it is .*: install the same"):
            evaluated(VECTORS, cluster)

    def join(ended, count):
        cluster.versions |= {"late": "0", "none": none, "gone": OSError("Timed out"), "good": ours}

    def late(answer):
        """Return the answer of a worker that took its part before anyone asked for its version."""
        if not isinstance(answer, Answer) or not answer.seconds or next(count) > 5:
            return answer
        environment = answer.worker.environment | {"mdm": "0"}
        return Answer(msgspec.structs.replace(answer.worker, environment=environment), failure="another version")

    count = iter(range(100))
    cluster = Cluster(a=ours)
    cluster._changed = late
    with patch.object(parts, "_LONG", 0.0), cluster, pytest.warns(WorkerWarning) as told:
        assert kept(evaluated(Cautious(), cluster, progress=join)) == kept(evaluated(Cautious()))
    assert sorted(str(each.message).partition(", but here")[0] for each in told) == [
        "late has mdm 0",
        "none has no mdm (No module named 'mdm')",
    ]
    assert (cluster.named[0], set(cluster.named[-1])) == (None, {"a", "good"})


def test_a_scheduler_that_ends_leaves_what_has_ended():
    cluster = Cluster(a=mdm.__version__)

    def lost():
        raise OSError("the connection is closed")

    def progress(ended, _):
        if ended > 5:
            cluster.nthreads = lost

    with patch.object(parts, "_LONG", 0.0), cluster, pytest.warns(WorkerWarning, match="the executor has ended: the c"):
        result = evaluated(Cautious(), cluster, progress=progress)
    assert 5 < result.episodes == 45 - result.missing < 45


def test_threads_are_workers_too():
    with ThreadPoolExecutor(2) as executor:
        assert kept(simulated(Cautious(), executor)) == kept(simulated(Cautious()))


@pytest.mark.parametrize("run", [evaluated, simulated])
def test_its_seed_repeats_what_was_drawn_without_one(run):
    found = run(RandomPolicy(3, 2), seed=None)
    assert kept(run(RandomPolicy(3, 2), seed=found.seed)) == kept(found)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2, 5])
def test_processes_give_the_same_bytes(workers):
    pool = ProcessPoolExecutor(2, get_context("spawn")) if workers == 2 else Processes(workers)
    with pool as executor:
        for run in (evaluated, simulated, compared):
            for policy in (VECTORS, Cautious()):
                assert kept(run(policy, executor)) == kept(run(policy))


@pytest.mark.slow
def test_a_killed_process_ends_a_users_pool_and_not_ours(tmp_path):
    whole = evaluated(Cautious())
    with Processes(2) as executor, patch.object(parts, "_LONG", 0.0):
        assert kept(evaluated(Once(tmp_path / "a", kills=True), executor)) == kept(whole)
    with (
        ProcessPoolExecutor(1, get_context("spawn")) as executor,  # so that no part has ended
        pytest.raises(Error, match="the executor has ended: A process"),
    ):
        evaluated(Once(tmp_path / "b", kills=True), executor)


@pytest.mark.slow
def test_dask_gives_the_same_bytes():
    distributed = pytest.importorskip("distributed", reason="Dask (the extra mdm[dask]) is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with (
            distributed.LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=None) as cluster,
            distributed.Client(cluster) as client,
        ):
            for run in (evaluated, simulated, compared):
                assert kept(run(Cautious(), client.get_executor())) == kept(run(Cautious()))
