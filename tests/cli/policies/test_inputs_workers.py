"""The workers of a command: the same output whoever ran it, and what is refused."""

from __future__ import annotations

import importlib
import json
from types import SimpleNamespace

import pytest
from places import TIGER, TIGER_VECTORS
from sentences import refused

from mdm import Error, WorkerWarning
from mdm.cli.policies import inputs

FEW = (TIGER, TIGER_VECTORS, "--episodes", "40", "--steps", "5", "--seed", "2")


def told(output):
    """Return an object, or a list of them, and apart from it what differs from run to run."""
    found = json.loads(output[0])
    return found, [each.pop("run", None) for each in (found if isinstance(found, list) else [found])]


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["evaluate", "simulate", "compare"])
def test_the_same_is_printed_whoever_ran_it(mdm, verb):
    given = (FEW[0], *FEW[1:2] * (2 if verb == "compare" else 1), *FEW[2:])
    alone, _ = told(mdm(verb, *given, "--json")[1])
    for number in (1, 2):
        status, output, error = mdm(verb, *given, "--json", "--workers", number)
        assert (status, error) == (0, "")
        found, runs = told(output)
        for each in found if verb == "compare" else [found]:
            if verb == "simulate":
                assert each.pop("missing") == 0
        assert found == alone
        assert all(sum(worker["parts"] for worker in run["workers"]) >= 1 for run in runs)
    lines = [line for line in mdm(verb, *given, "--workers", 1)[1] if "steps a second" not in line]
    assert lines == [line for line in mdm(verb, *given)[1] if "steps a second" not in line]


@pytest.mark.parametrize("verb", ["evaluate", "simulate", "compare"])
def test_a_result_with_parts_missing_is_told_and_a_failure(mdm, monkeypatch, verb):
    from worked import Shuffled

    from mdm.simulation import parts, simulate
    from mdm.simulation.batch import EpisodeBatch

    del simulate
    monkeypatch.setattr("mdm.simulation.Processes", Shuffled)
    monkeypatch.setattr(parts, "_LONG", 0.0)
    monkeypatch.setattr("mdm.simulation.batch._FIRST", 10)
    run = EpisodeBatch.__call__

    def fails(batch, episodes, *arguments):
        if episodes == 30:
            raise OSError("no memory")
        return run(batch, episodes, *arguments)

    monkeypatch.setattr(EpisodeBatch, "__call__", fails)
    monkeypatch.setattr("mdm.simulation.world.World._move", _breaks)
    status, output, error = mdm(verb, *FEW, "--workers", "1")
    assert status == 1
    assert "30 episodes of seed 2 are missing" in error or "no part has ended" in error
    assert "no memory" in error
    if verb != "simulate":
        assert any("10 episodes" in line for line in output)


def _breaks(world, action):
    raise OSError("no memory")


def test_what_cannot_be_had_is_refused(mdm, monkeypatch, tmp_path):
    for verb in ("evaluate", "simulate", "compare"):
        assert "auto or a whole number of 0 or more was expected" in mdm(verb, *FEW, "--workers", "-1")[2]
        assert "give either" in mdm(verb, *FEW, "--workers", "1", "--dask", "here")[2]
    assert "a record is of one process" in mdm("simulate", *FEW, "--workers", "1", "--record", tmp_path / "a.mcap")[2]

    def absent(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(importlib, "import_module", absent)
    with refused(Error), inputs.executor_of(SimpleNamespace(dask="tcp://here:1", workers=0)):
        pass


def test_a_scheduler_that_is_not_there_or_has_no_workers_is_refused(monkeypatch, tmp_path):
    file, given = tmp_path / "scheduler.json", []

    class Client:
        def __init__(self, address, **_):
            given.append(address)
            if "there" not in address:
                raise OSError("Timed out trying to connect")

        def nthreads(self):
            return {}

        def close(self):
            pass

    monkeypatch.setattr(importlib, "import_module", lambda name: SimpleNamespace(Client=Client))
    for wrong in ("tcp://here:1", "here", str(file)):
        with refused(Error):
            inputs._client(wrong)
    for content in ("x", "[]", "{}"):
        file.write_text(content)
        with refused(Error):
            inputs._client(str(file))
    file.write_text(json.dumps({"address": "tcp://there:2", "workers": {}}))
    with pytest.raises(Error, match="has no workers: start some by dask worker tcp://there:2"):
        inputs._client(str(file))
    assert given == ["tcp://here:1", "tcp://there:2"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_dask_scheduler(mdm):
    distributed = pytest.importorskip("distributed", reason="Dask (the extra mdm[dask]) is not installed")
    alone = told(mdm("simulate", *FEW, "--json")[1])[0]
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        status, output, _ = mdm("simulate", *FEW, "--json", "--dask", cluster.scheduler_address)
    found, runs = told(output)
    assert (status, found.pop("missing"), found) == (0, 0, alone)
    assert runs[0]["workers"]
    assert issubclass(WorkerWarning, UserWarning)
