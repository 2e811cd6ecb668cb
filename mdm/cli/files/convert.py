"""``mdm convert``: conversion of models and policies between formats, with a report of losses."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.cli.files.info import is_policy, kind_of
from mdm.cli.usage import UsageError
from mdm.formats import load_model, load_policy, save_model, save_policy
from mdm.formats.source import suffixes
from mdm.formats.target import check_place
from mdm.models.matrices import is_compressed

if TYPE_CHECKING:
    import argparse

    from mdm.models import MDP


def run(arguments: argparse.Namespace) -> int:
    """Convert the file; return the exit status."""
    check_place(arguments.target, arguments.source, arguments.model)
    if suffixes(arguments.source) == ".toml":
        raise UsageError("a TOML file holds ensembles, which have no other format")
    if is_policy(arguments.source):
        if arguments.discount is not None or arguments.normalize:
            raise UsageError("--discount and --normalize are for models; this file holds a policy")
        model = None if arguments.model is None else load_model(arguments.model)
        policy = load_policy(arguments.source, model)
        save_policy(policy, arguments.target, model)
        if Path(arguments.target).is_file():  # devices and pipes cannot be read back
            load_policy(arguments.target, model)
        print(f"{arguments.target}: {kind_of(policy)}")
        return 0
    if arguments.model is not None:
        raise UsageError("--model is for policies; this file holds a model itself")
    source = load_model(arguments.source, normalize=arguments.normalize)
    discount = source.discount if arguments.discount is None else arguments.discount
    source = source.with_discount(discount, of=arguments.discount_of)
    save_model(source, arguments.target)
    print(f"{arguments.target}: {kind_of(source)}")
    if Path(arguments.target).is_file():
        for line in _changes(source, load_model(arguments.target)):
            print(f"mdm: warning: {line}", file=sys.stderr)
    return 0


def _changes(model: MDP, written: MDP) -> list[str]:
    """Return the differences between a model and its written file."""
    pairs = [
        ("agents", model.num_agents, written.num_agents),
        ("state factors", len(model.state_space.factors), len(written.state_space.factors)),
    ]
    if model.observation_space is not None and written.observation_space is not None:
        before, after = model.observation_space.factors, written.observation_space.factors
        pairs.append(("observation factors", len(before), len(after)))
    found = [f"{before} {what} became {after}" for what, before, after in pairs if before != after]
    if model.network is not None and written.network is None:
        found.append("the network of the factored model became matrices")
    if model.outcome_rewards is not None and written.outcome_rewards is None:
        found.append("rewards of single outcomes became their expectation R(s, a)")
    difference = _difference(model, written)
    if difference > 0:
        found.append(f"numbers differ by at most {difference:.3g}")
    return found


def _difference(model: MDP, written: MDP) -> float:
    """Return the largest difference between two models' numbers; rewards are relative to the largest reward."""
    scale = max(1.0, float(np.abs(model.rewards).max()))
    worst = [
        float(np.abs(model.rewards - written.rewards).max()) / scale,
        float(np.abs(model.initial_belief - written.initial_belief).max()),
    ]
    for action in range(len(model.action_space)):
        worst.append(_distance(model.transition_matrix(action), written.transition_matrix(action)))
        if (before := model.pomdp) is None or (after := written.pomdp) is None:
            continue
        if before.event_observations:
            each = range(len(before.observation_space))
            worst += [_distance(before.joint_matrix(action, o), after.joint_matrix(action, o)) for o in each]
        else:
            worst.append(_distance(before.observation_matrix(action), after.observation_matrix(action)))
    return max(worst)


def _distance(left: Any, right: Any) -> float:
    if is_compressed(left) != is_compressed(right):
        left, right = (each.toarray() if is_compressed(each) else each for each in (left, right))
    return float(np.abs(left - right).max())
