"""The shares that work reports, from its beginning to its end."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from maps.floors import offices

import mdm
from mdm.maps.draft import draft
from mdm.models import MDP
from mdm.policies import AlphaVectors
from mdm.progress import followed, report_share


def shares_of(work):
    """Return the shares that a piece of work reports, by what it is."""
    told = {}
    with followed(lambda name, share: told.setdefault(name, []).append(share)):
        work()
    return told


def is_complete(shares):
    return shares[0] == 0 and shares[-1] == 1 and sorted(shares) == shares and len(set(shares)) > 2


@pytest.mark.parametrize("name", ["model.pomdp", "model.pomdp.gz", "model.pomdpx", "model.dpomdp"])
def test_the_reading_of_a_model(tmp_path, name):
    random = np.random.default_rng(1)
    rows = random.dirichlet(np.ones(50), size=(4, 50)).round(6)
    rows[..., -1] += 1 - rows.sum(-1)
    model = mdm.models.POMDP(rows, rows, np.zeros((50, 4)), discount=0.9)
    mdm.save_model(model, tmp_path / name)
    told = shares_of(lambda: mdm.load_model(tmp_path / name))
    assert set(told) == {f"reading {name}"}
    shares = told[f"reading {name}"]
    last = len(shares) - 1 - shares[::-1].index(0)  # a file may be looked into before it is read
    assert is_complete(shares[last:])


def test_the_reading_of_alpha_vectors(tmp_path):
    mdm.save_policy(AlphaVectors(np.eye(9), [0] * 9), tmp_path / "policy.vf")
    told = shares_of(lambda: mdm.load_policy(tmp_path / "policy.vf"))
    assert told["reading policy.vf"][-10:] == [*(place / 9 for place in range(9)), 1]


def test_what_cannot_be_read_does_not_end(tmp_path):
    mdm.save_model(MDP([np.eye(3)] * 2, np.zeros((3, 2)), discount=0.9), tmp_path / "model.mdp")
    with (tmp_path / "model.mdp").open("a") as file:
        file.write("T: 0 : 0 : 0 nothing\n")
    told = {}
    with (
        pytest.raises(mdm.FormatError),
        followed(lambda name, share: told.setdefault(name, []).append(share)),
    ):
        mdm.load_model(tmp_path / "model.mdp")
    assert max(told["reading model.mdp"]) < 1


def test_a_draft():
    floor = offices()
    told = shares_of(lambda: draft(floor.grid, floor.graph(floor.random_points(np.random.default_rng(1)))))
    assert list(told) == ["drafting the labels"]
    assert is_complete(told["drafting the labels"])


def test_who_does_not_follow_hears_nothing():
    told = []
    with followed(lambda *given: told.append(given)):
        report_share("this", 0.5)
        other = threading.Thread(target=report_share, args=("of another thread", 0.5))
        other.start()
        other.join()
        with followed(lambda *_: None):
            report_share("of one within", 0.5)
    report_share("afterwards", 0.5)
    assert told == [("this", 0.5)]
