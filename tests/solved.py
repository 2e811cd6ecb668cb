"""Policies that tests start from, solved once: kept in `data/solved` by the digest of their model.

The numbers of such a model have to be the same on every machine: sums and products, no powers and no logarithms.
A test in the outer ring solves each again. `MDM_SOLVED=write` before `python -m pytest` and the tests that ask writes
what is new.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mdm import load_policy, save_model, save_policy, solve
from mdm.models.digest import digest

if TYPE_CHECKING:
    from mdm.models import MDP
    from mdm.policies import Policy

WRITING = "MDM_SOLVED"
FOLDER = Path(__file__).parent / "data" / "solved"


class Solved(NamedTuple):
    """A policy with the bounds of its value that were proved."""

    policy: Policy
    lower: float
    upper: float


def facts() -> dict[str, dict[str, Any]]:
    """Return the options and the bounds of all policies, by the digest of their model."""
    return json.loads((FOLDER / "solved.json").read_text(encoding="utf-8"))


def solved(model: MDP, **options: float) -> Solved:
    """Return the solution of a model that `solve` found with these options, from its file."""
    name = digest(model)
    if os.environ.get(WRITING) == "write":
        _write(model, name, options)
    kept = facts().get(name, {})
    assert kept.get("options") == options, (
        f"{FOLDER} has no policy for this model that was solved with {options}: write it by"
        f" {WRITING}=write python -m pytest, and the file of this test"
    )
    return Solved(load_policy(FOLDER / f"{name}.policy", model), kept["lower"], kept["upper"])


def _write(model: MDP, name: str, options: dict[str, float]) -> None:
    solution = solve(model, **options)
    FOLDER.mkdir(exist_ok=True)
    save_model(model, FOLDER / f"{name}.npz")
    save_policy(solution.policy, FOLDER / f"{name}.policy", model)
    path = FOLDER / "solved.json"
    all_ = (facts() if path.exists() else {}) | {
        name: {"options": options, "lower": solution.lower, "upper": solution.upper}
    }
    path.write_text(json.dumps(dict(sorted(all_.items())), indent=2) + "\n", encoding="utf-8")
