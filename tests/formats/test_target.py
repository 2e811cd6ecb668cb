"""Files are written whole or not at all, whatever they hold."""

from __future__ import annotations

import os
import resource
import stat
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from sentences import refused

from mdm import FormatError, save_model, save_policy
from mdm.formats.madp import q_table
from mdm.formats.target import check_place, replacing, write_text
from mdm.models import MDP, POMDP
from mdm.policies import (
    AlphaVectors,
    DeterministicPolicy,
    FiniteStateController,
    JointController,
    MaskedAlphaVectors,
    MixedAlphaVectors,
    QTable,
    StochasticPolicy,
)

SIZE = 300
STATES = np.eye(SIZE)
MODEL = POMDP([STATES], np.full((1, SIZE, 2), 0.5), np.arange(float(SIZE))[:, None], discount=0.9)
PROCESS = MDP([STATES], np.arange(float(SIZE))[:, None], discount=0.9)
VECTORS = AlphaVectors([np.arange(float(SIZE))], [0], 1)
CHAIN = FiniteStateController([0] * SIZE, [[1 - node % 2] * 2 for node in range(SIZE)], values=np.ones((SIZE, SIZE)))
PLANS = [([0] * 511, [[2 * node + 1, 2 * node + 2] if node < 255 else [None, None] for node in range(511)])]

WRITERS = [
    *((f"m{suffix}", lambda path: save_model(MODEL, path)) for suffix in (".pomdp", ".dpomdp", ".pgmx", ".pomdpx")),
    ("m.npz", lambda path: save_model(MODEL, path)),
    ("m.mdp", lambda path: save_model(PROCESS, path)),
    *((f"v{suffix}", lambda path: save_policy(VECTORS, path)) for suffix in (".alpha", ".vf", ".policy", ".npz")),
    ("observed.policy", lambda path: save_policy(MixedAlphaVectors([np.ones(SIZE)] * 2, [0, 0], [0, 1], 1), path)),
    ("masked.policy", lambda path: save_policy(MaskedAlphaVectors([dict.fromkeys(range(SIZE), 1.0)], [0], SIZE), path)),
    ("table.policy", lambda path: save_policy(DeterministicPolicy([0] * SIZE), path)),
    ("chances.policy", lambda path: save_policy(StochasticPolicy(np.ones((1, SIZE))), path)),
    ("values.policy", lambda path: save_policy(QTable(np.ones((SIZE, 1))), path)),
    ("rows", lambda path: q_table.write(QTable(np.ones((SIZE, 1))), path)),
    ("graph.pg", lambda path: save_policy(CHAIN, path)),
    ("plan.policy", lambda path: save_policy(JointController(FiniteStateController(*p) for p in PLANS), path, MODEL)),
]


@contextmanager
def disk_of(size):
    """Let no file grow beyond a size, as on a full disk; but for compiled modules, which Python would leave cut off."""
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    writing, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))
        sys.dont_write_bytecode = writing


@pytest.mark.parametrize(("name", "write"), WRITERS, ids=[name for name, _ in WRITERS])
def test_a_disk_that_fills_up_leaves_what_was_there(tmp_path, name, write):
    path = tmp_path / name
    path.write_text("what was there")
    beside = path.with_suffix(".alpha")
    beside.write_text("and beside it")
    with disk_of(200), refused(FormatError):
        write(path)
    before = {path.name: "what was there", beside.name: "and beside it"}
    if path == beside:
        before = {path.name: "and beside it"}
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == before
    write(path)
    assert path.stat().st_size > 200


def test_no_stop_in_the_middle_of_a_write_is_seen(tmp_path):
    path = tmp_path / "x"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), replacing(path) as file:
        file.write(b"new")
        raise KeyboardInterrupt
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("x", "old")]


def test_what_is_written_is_on_the_disk_before_it_takes_its_place(tmp_path, monkeypatch):
    path = tmp_path / "x"
    path.write_text("old")
    seen = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: seen.append((os.fstat(descriptor).st_size, path.read_text())))
    write_text(path, "newer")
    assert seen == [(5, "old")]
    assert path.read_text() == "newer"


def test_permissions_stay_and_new_files_have_the_usual_ones(tmp_path):
    old, new, plain = tmp_path / "old", tmp_path / "new", tmp_path / "plain"
    old.write_text("old")
    old.chmod(0o640)
    plain.write_text("as any program makes it")
    write_text(old, "new")
    write_text(new, "new")
    assert stat.S_IMODE(old.stat().st_mode) == 0o640
    assert new.stat().st_mode == plain.stat().st_mode


@pytest.mark.skipif(os.geteuid() == 0, reason="an administrator may write any file")
def test_a_protected_file_is_not_replaced(tmp_path):
    path = tmp_path / "x"
    path.write_text("old")
    path.chmod(0o444)
    with refused(FormatError):
        write_text(path, "new")
    assert path.read_text() == "old"


@pytest.mark.parametrize("is_there", [True, False])
def test_a_link_stays_and_leads_to_what_is_new(tmp_path, is_there):
    (tmp_path / "folder").mkdir()
    path, link = tmp_path / "folder" / "x", tmp_path / "link"
    link.symlink_to(Path("folder") / "x")
    if is_there:
        path.write_text("old")
    write_text(link, "new")
    assert link.is_symlink()
    assert path.read_text() == "new"
    assert not path.is_symlink()
    assert sorted(file.name for file in tmp_path.rglob("*")) == ["folder", "link", "x"]


def test_a_pipe_is_written_as_it_stands(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        check_place(path)
        write_text(path, "text")
        assert os.read(reader, 9) == b"text"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(path.stat().st_mode)


def test_a_folder_is_no_place_for_a_file(tmp_path):
    for refuse in (check_place, lambda path: write_text(path, "")):
        with refused(FormatError):
            refuse(tmp_path)
    with refused(FormatError):
        check_place(tmp_path / "nowhere" / "x")
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_read_is_no_place_for_another(tmp_path):
    source, other = tmp_path / "x", tmp_path / "y"
    source.write_text("x")
    other.symlink_to(source)
    for place in (source, other):
        with refused(FormatError):
            check_place(place, None, source)
    check_place(tmp_path / "z", source, other)
    check_place("/dev/null", "/dev/null")
