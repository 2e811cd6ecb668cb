"""Matrices that processes share: to the last bit those that each would make, from one file."""

from __future__ import annotations

import gc
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from patience import PATIENCE

import mdm
from mdm import Controller
from mdm.errors import ModelWarning
from mdm.formats.archive import flat
from mdm.loading import spared
from mdm.models import FactoredMDP, FactoredPOMDP, Node, Space, Table, TwoSliceNetwork
from mdm.models.dynamics import Dynamics, Rows
from mdm.models.events import TransitionEvents
from mdm.models.matrices import is_compressed
from mdm.solvers.online.tree_search import search_tables


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MDM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(flat, "_LEAST", 0)
    return tmp_path / "cache"


def walker(size, *, events=False, rest=0.0, sparse=None, decided=True):
    """Return a model of a walk on a ring, where something is heard of the place, or of the step."""
    random = np.random.default_rng(size)
    place, after, heard = Node("state", 0), Node("next_state", 0), Node("observation", 0)
    moves = np.zeros((2, size, size))
    for step in (0, 1):
        for at in range(size):
            moves[step, at, [at, (at + 1 + step) % size]] = 0.3, 0.7
    told = random.random((size, size, 3) if events else (2, size, 3))
    told *= (1 - rest) / told.sum(axis=-1, keepdims=True)
    network = TwoSliceNetwork(
        Space.single("place", size),
        Space.single("agent", 2),
        Space.single("agent", 3) if decided else None,
        initial=[Table([place], np.full(size, 1 / size))],
        transitions=[Table([Node("action", 0), place, after], moves)],
        observation=[Table([place if events else Node("action", 0), after, heard], told)] if decided else [],
        utilities=[Table([place, after], random.random((size, size)))],
    )
    return (FactoredPOMDP if decided else FactoredMDP)(network, discount=0.9, sparse=sparse)


MODELS = {
    "rocks": mdm.problems.rock_sample,
    "fires": lambda: mdm.problems.fire_fighting(houses=3, team=3),
    "seen": lambda: mdm.problems.tag().revealed(),
    "dense": lambda: walker(20),
    "sparse": lambda: walker(20, sparse=True),
    "an MDP": lambda: walker(20, decided=False),
    "a sparse MDP": lambda: walker(20, decided=False, sparse=True),
    "events": lambda: walker(12, events=True),
    "sparse events": lambda: walker(12, events=True, sparse=True),
}


def same(one, other):
    if not is_compressed(one):
        return one.dtype == other.dtype and np.array_equal(one, other) and not other.flags.writeable
    parts = ("data", "indices", "indptr")
    return one.shape == other.shape and all(same(getattr(one, part), getattr(other, part)) for part in parts)


@pytest.mark.parametrize("name", MODELS)
def test_what_is_mapped_is_what_would_be_made(name, folder):
    own, shared = MODELS[name]().flatten(), spared(MODELS[name]()).flatten()
    (path,) = folder.iterdir()
    assert str(path) in maps()
    assert type(own) is type(shared)
    assert same(own.rewards, shared.rewards)
    assert same(own.initial_belief, shared.initial_belief)
    for action in range(len(own.action_space)):
        assert same(own.transition_matrix(action), shared.transition_matrix(action))
        if isinstance(own, mdm.models.POMDP) and own.events is None:
            assert same(own.observation_matrix(action), shared.observation_matrix(action))
    if isinstance(own, mdm.models.POMDP) and own.events is not None:
        assert type(own.events) is type(shared.events)
        plain = not isinstance(own.events, TransitionEvents)
        for one, other in zip(own.events.events, shared.events.events, strict=True):
            assert same(one, other) if plain else np.array_equal(one.toarray(), other.toarray())
    one, other = Dynamics(own), Dynamics(shared)
    for part in ("transitions", "observations") if isinstance(own, mdm.models.POMDP) else ("transitions",):
        for array, mapped in zip(getattr(one, part), getattr(other, part), strict=True):
            # Of one kind for what compiles, too.
            assert (array.dtype, array.flags.writeable) == (mapped.dtype, mapped.flags.writeable)
            assert np.array_equal(array, mapped)


def maps():
    return Path("/proc/self/maps").read_text()


def test_rows_are_not_copied():
    shared = spared(walker(20, sparse=True)).flatten()
    dynamics = Dynamics(shared)
    pairs = (dynamics.transitions, shared.transition_matrix), (dynamics.observations, shared.observation_matrix)
    for rows, matrix in pairs:
        assert np.shares_memory(rows.values, matrix(1).data)
        assert np.shares_memory(rows.columns, matrix(1).indices)


def steps(controller, seed=0, count=25):
    random = np.random.default_rng(seed)
    told = [controller.start(), *(controller.observe(int(random.integers(3))) for _ in range(count))]
    return [(step.action, step.probability) for step in told], controller.belief.tolist()


@pytest.mark.parametrize(
    "model",
    [
        lambda: walker(150, sparse=True).with_false_negatives(0),
        lambda: walker(140, events=True, rest=0.1, sparse=True),
        lambda: walker(60),
    ],
    ids=["a false negative", "events that leave something", "small"],
)
def test_beliefs_and_decisions_are_the_same(model, folder, monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # of the events, what they leave
        vectors = np.random.default_rng(1).random((6, len(model().state_space)))
        policy = mdm.policies.AlphaVectors(vectors, [0, 1, 0, 1, 0, 1], 2)
        shared = steps(Controller(policy, model(), memory=500))
        assert [path.suffix for path in folder.iterdir()] == [".npz"]
        monkeypatch.setenv("MDM_CACHE", "")
        gc.collect()
        own = steps(Controller(policy, model(), memory=500))
    assert shared == own


@pytest.mark.parametrize("decided", [True, False])
def test_a_search_reads_the_same_model_and_the_same_bounds(folder, decided):
    own = search_tables(walker(150, sparse=True, decided=decided), upper=None, lower=None)
    shared = search_tables(spared(walker(150, sparse=True, decided=decided)), upper=None, lower=None)
    assert list(folder.iterdir())
    for one, other in zip(own, shared, strict=True):
        parts = zip(one, other, strict=True) if isinstance(one, Rows) else [(one, other)]
        assert all(np.array_equal(part, mapped) for part, mapped in parts)


def test_another_number_is_another_file(folder):
    for model in (walker(20), walker(20).with_discount(0.8), walker(20, sparse=True), walker(21)):
        spared(model).flatten()
    assert len(list(folder.iterdir())) == 4


def test_a_process_maps_a_model_once(folder):
    first = spared(walker(20)).flatten()
    assert spared(walker(20)).flatten() is first
    del first
    gc.collect()
    assert str(folder) not in maps()


def test_small_models_have_no_file(folder, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setenv("MDM_CACHE", str(folder))
    spared(walker(20)).flatten()
    assert not folder.exists()


def test_without_a_folder_each_has_its_own(folder, monkeypatch):
    monkeypatch.setenv("MDM_CACHE", "")
    spared(walker(20)).flatten()
    assert not folder.exists()


def test_who_is_not_to_be_sparing_writes_nothing(folder):
    walker(20).flatten()
    walker(20).sparingly().flatten()
    assert not folder.exists()


@pytest.mark.parametrize("wrong", ["a file in its place", "no room"])
def test_where_there_can_be_no_file_one_line_says_so_and_the_matrices_are_made_once(folder, monkeypatch, wrong):
    if wrong == "a file in its place":
        folder.write_text("")
    else:
        monkeypatch.setattr("mdm.formats.archive.flat.shutil.disk_usage", lambda _: type("Disk", (), {"free": 0}))
    model, made = spared(walker(20)), []
    original = model._made
    monkeypatch.setattr(model, "_made", lambda: made.append(1) or original())
    with pytest.warns(ModelWarning, match="the model's matrices are not shared") as told:
        found = model.flatten()
    assert (len(told), len(made)) == (1, 1)
    assert same(found.transition_matrix(0), walker(20).transition_matrix(0))


PROGRAM = """
import hashlib, sys
import mdm
from mdm.loading import spared
from mdm.models.factored import flattening
made, original = [], flattening.transition_matrices
flattening.transition_matrices = lambda network: made.append(1) or original(network)
model = spared(mdm.problems.fire_fighting(houses=3, team=3)).flatten()
maps = [line.split() for line in open("/proc/self/maps") if ".npz" in line]
total = hashlib.sha256(b"".join(model.transition_matrix(a).data.tobytes() for a in range(27))).hexdigest()
print(len(made), *maps[0][3:5], total, flush=True)
input()
"""


def test_two_processes_that_start_together_map_one_file(folder):
    command = [sys.executable, "-c", PROGRAM]
    both = [subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    told = [process.stdout.readline().split() for process in both]  # both have it mapped now
    for process in both:
        process.communicate("\n", timeout=PATIENCE)
    made, devices, inodes, digests = zip(*told, strict=True)
    assert sorted(made) == ["0", "1"]
    (path,) = folder.iterdir()
    assert set(inodes) == {str(path.stat().st_ino)}
    assert len(set(devices)) == len(set(digests)) == 1
