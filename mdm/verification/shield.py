"""Shields: how a policy is kept from ever bringing a robot where it must not be.

The states from which X can be avoided for certain, and the actions that keep that so, come from the graph of the model
(C. Baier and J.-P. Katoen, *Principles of model checking*, 2008, section 10.6); such masks of policies are known as
shields (M. Alshiekh et al., *Safe reinforcement learning via shielding*, AAAI 2018). With stages all is over pairs of a
stage and a state. The cost is that of a search of the graph, and with a budget or ``keep`` of sparse linear solves.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_array, eye_array, kron

from mdm.errors import ConfigError, FormatError, ModelError, ModelWarning
from mdm.loading import model_of, policy_of
from mdm.models import MDP
from mdm.models.matrices import csr
from mdm.models.specification import Specification
from mdm.policies import BudgetedTable, Policy, ShieldedTable, mismatch
from mdm.policies.shielded import divided
from mdm.policies.table import Staged
from mdm.solvers import solve
from mdm.solvers.evaluation import state_values
from mdm.verification.choices import Choices, Graph
from mdm.verification.reaching import reach
from mdm.verification.supports import over_supports

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    import numpy.typing as npt

    from mdm.loading import GivenModel, GivenPolicy
    from mdm.models.matrices import Vector
    from mdm.models.space import Symbol
    from mdm.models.specification import Mask

    Transitions = Sequence[tuple[int, int, int]]
    Margin = Iterable[Sequence[Symbol]] | Callable[[MDP], Iterable[Sequence[Symbol]]]

_ROUNDING = 1e-9
_FAR = 0.999
"""The discount that values have in place of 1, where without it they have no bound."""


def shield(
    policy: GivenPolicy,
    model: GivenModel,
    *,
    avoid: str,
    keep: str | None = None,
    probability: float = 0.0,
    resolve: bool = False,
    margin: Margin = (),
) -> Policy:
    """Return a policy that does as another does, except where that may lead to X.

    An action is allowed if X can still be avoided for certain after it. Where the policy wants another, the best
    allowed one is taken: by the policy's own scores, and for a policy without them by the values of actions in the
    model if the policy goes on after them (for which it is evaluated once). In states from which X cannot be avoided
    for certain, the actions that make it least probable are allowed; at X itself, those that lead away from it so.

    Args:
        policy: A policy of any kind. The result keeps it, as ``policy``.
        model: The model, or the path of its file.
        avoid: X, a formula over states and actions as in `mdm.verify`, such as ``position = stairs``.
        keep: Stays possible: such as ``reach goal-*`` or ``reach goal before lift``. Where the policy under the shield
            attains less than the greatest probability that the allowed actions leave, an action is taken that attains
            it, in whatever time. Without it a robot may wait for ever before the first forbidden action.
        probability: A budget for the probability that a whole run ever reaches X, spent as the run goes; see
            `mdm.policies.BudgetedTable`. By default 0.
        resolve: Whether the model is solved again with the allowed actions, which are then taken by their values.
        margin: Transitions that the world may have although the model has none, each a state, an action and a state,
            by name or index; or a function of the model that returns them. The shield avoids X also where they happen.

    Raises:
        ConfigError: If an option is wrong, the policy is for another model, no state at the start can be kept from X,
            the least probability of X is above the budget, or the shield makes ``keep`` impossible or lets the robot
            stand for ever in a state that the policy would leave.
        ModelError: If the model has no such name, or the policy or model cannot be shielded.

    Example::

        safe = mdm.shield("grid.policy", "grid.mdp", avoid="pit-*", keep="reach goal")
        mdm.verify("grid.mdp", "P(reach pit-*)", safe).result.value  # 0.0
        safe.wanted(7)  # the action that the policy itself would have taken in state 7, where it is another
    """
    model = model_of(model)
    original: Any = policy_of(policy, model)
    if (wrong := mismatch(original, model)) is not None:
        raise ConfigError(wrong, key="policy")
    if isinstance(probability, bool) or not isinstance(probability, int | float) or not 0 <= probability <= 1:
        raise ConfigError(f"a budget is a probability from 0 to 1, not {probability!r}", key="probability")
    target = _asked(model, avoid, f"P(reach {avoid})", "avoid")
    kept = None if keep is None else _asked(model, keep, f"P({keep})", "keep")
    if target.before is not None:
        raise ConfigError(f"X is avoided for ever, and {avoid!r} has a 'before'", key="avoid")
    added = _triples(model, margin)
    if added and probability:
        raise ConfigError("the transitions of a margin have no probability: give no budget", key="margin")
    made: Any
    if getattr(original, "input", "belief") == "state" and not getattr(original, "deliberates", False):
        made = _Maker(model, original, target, added, float(probability)).shielded(kept, resolve=resolve)
    else:
        if resolve or probability or (kept is not None and kept.before is not None):
            why = f"a {type(original).__name__} is shielded by the support of its belief"
            raise ConfigError(f"{why}: that allows no budget, no 'before', and solves nothing again", key="policy")
        made = over_supports(original, model, target.target, None if kept is None else kept.target, added)
    made.avoid, made.keep, made.probability = avoid, keep, float(probability)
    result: Policy = made
    return result


def _asked(model: MDP, given: str, text: str, key: str) -> Specification:
    if not isinstance(given, str):
        raise ConfigError(f"a formula is a text such as 'reach goal', not {given!r}", key=key)
    try:
        asked = Specification.of(text, model)
    except FormatError as error:
        raise ConfigError(f"{text}: {error}", key=key) from None
    if asked.kind != "P" or asked.always or asked.within is not None:
        raise ConfigError(f"{given!r} has to be without 'always' and 'within', as a shield counts no steps", key=key)
    return asked


def _triples(model: MDP, margin: Margin) -> list[tuple[int, int, int]]:
    """Return the indices of transitions."""
    states, actions, found = model.state_space, model.action_space, []
    given: Any = margin(model) if callable(margin) else margin
    if isinstance(given, str) or not hasattr(given, "__iter__"):
        raise ConfigError(f"a margin is a list of transitions [state, action, state], not {given!r}", key="margin")
    for each in given:
        if not isinstance(each, list | tuple) or len(each) != 3:
            raise ConfigError(f"a margin is of transitions [state, action, state], not {each!r}", key="margin")
        found.append((states.index(each[0]), actions.index(each[1]), states.index(each[2])))
    return found


class _Maker:
    """Makes the shield of a policy over states.

    All arrays are over places: states, or with stages the states of each stage, one stage after the other.
    """

    def __init__(self, model: MDP, policy: Any, avoid: Specification, margin: Transitions, budget: float) -> None:
        if getattr(policy.information(model), "takes", "observation") != "state" or not hasattr(policy, "weights"):
            raise ModelError(f"a {type(policy).__name__} keeps more than states in mind, and cannot be shielded")
        self._model, self._policy, self._target, self._budget = model, policy, avoid.target, budget
        self._size, self._count, self._stages = len(model.state_space), len(model.action_space), policy.horizon
        self._wants = np.concatenate([policy.weights(stage).T for stage in range(self._stages or 1)])
        self._start = np.zeros(len(self._wants))
        self._start[: self._size] = model.initial_belief
        self._its, at_end = self._choices(avoid.target), avoid.target.copy()
        at_end[:, :-1] = False
        self._free = self._choices(at_end)
        self._least = reach(self._its, greatest=False)
        self._worth = self._its.hit + np.asarray(self._its.moves @ self._least.values)
        self._allowed = self._mask(avoid.text[8:-1], margin)

    def _choices(self, target: Mask, before: Mask | None = None, margin: Transitions = ()) -> Choices:
        """Return the choices; those of the last stage reach X also where it holds behind them."""
        its = Choices.of_model(self._model, target, before)
        if margin:
            state, action, after = np.array(margin).T
            keys = its.state * self._count + its.action
            known = np.isin(state * self._count + action, keys)
            rows = np.searchsorted(keys, (state * self._count + action)[known])
            added = coo_array((np.ones(len(rows)), (rows, after[known])), shape=its.moves.shape)
            its = its._replace(moves=csr(its.moves + added))
        if (stages := self._stages) is None:
            return its
        hit, miss = np.tile(its.hit, (stages, 1)), np.tile(its.miss, (stages, 1))
        hit[-1] += its.moves @ target[:, -1]
        miss[-1] += its.moves @ ~target[:, -1]
        places = np.arange(stages)[:, None] * self._size + its.state
        moves = kron(eye_array(stages, k=1), its.moves, format="csr")  # of another format it may have zeros
        return Choices(moves, hit.ravel(), miss.ravel(), places.ravel(), np.tile(its.action, stages))

    def _mask(self, avoid: str, margin: Transitions) -> Mask:
        """Return which choices are allowed."""
        its, least, begins = self._its, self._least, self._start > 0
        away = self._free.hit + np.asarray(self._free.moves @ least.values)
        hits = self._target[its.state % self._size, its.action]
        inside = np.minimum.reduceat(hits, its.firsts[:-1])  # whatever is done there
        worth = np.where(inside[its.state], away, self._worth)
        lowest = np.minimum.reduceat(worth, its.firsts[:-1])
        allowed: Mask = worth <= lowest[its.state] + least.error + _ROUNDING
        for each in [its, self._choices(self._target, margin=margin)] if margin else [its]:
            avoids, avoiding = Graph(each).avoiding()
            allowed = np.where(avoids[its.state], avoiding, allowed)
        first, safe = float(self._start @ least.values), avoids[begins]
        if self._budget and first > self._budget + _ROUNDING:
            told = f"X is reached with probability {first:.6g} at least"
            raise ConfigError(f"{told}, which is more than the budget of {self._budget:g}", key="probability")
        if self._budget == 0 and not safe.all():
            where = f"it is reached with probability {first:.6g} at least"
            where = "with the margin no action is certain to avoid it" if margin else where
            if not safe.any():
                raise ConfigError(f"no action keeps the start from {avoid!r}: {where}", key="avoid")
            states = f"{(~safe).sum()} of the {len(safe)} first states from {avoid!r}: {where}"
            warnings.warn(f"no action keeps {states}", ModelWarning, stacklevel=4)
        return allowed

    def _by_action(self, numbers: Any, otherwise: float) -> npt.NDArray[Any]:
        """Return numbers of choices as an array, places x actions."""
        array: npt.NDArray[Any] = np.full(self._wants.shape, otherwise)
        array[self._its.state, self._its.action] = numbers
        return array

    def _under(self, choices: Choices, weights: Vector) -> Choices:
        """Return the chain of some weights, places x actions."""
        its = weights[choices.state, choices.action]
        mixed = csr((its, np.arange(len(its)), choices.firsts), (choices.size, len(its)))
        moves, hit, miss = (mixed @ each for each in (choices.moves, choices.hit, choices.miss))
        return Choices(csr(moves), hit, miss, np.arange(choices.size), np.zeros(choices.size, dtype=np.intp))

    def shielded(self, kept: Specification | None, *, resolve: bool) -> Policy:
        """Return the policy."""
        allowed = self._by_action(self._allowed, False)
        best = self._solved(allowed) if resolve else self._best(allowed)
        taken = np.where(resolve | ~allowed, best[:, None], np.arange(self._count)).astype(np.int32)
        weights, follows = np.zeros_like(self._wants), np.ones_like(allowed)
        np.add.at(weights, (np.arange(len(taken))[:, None], taken), self._wants)
        if kept is not None:
            choices = self._choices(kept.target, kept.before)
            attains = reach(choices.subset(self._allowed), greatest=True)
            if not self._start @ attains.values > 0:
                raise ConfigError(f"the shield leaves no way to {kept.text}", key="keep")
            if self._budget:
                choices = self._choices(kept.target | self._target, kept.before)
                attains = reach(choices.subset(self._allowed), greatest=True)
                its = reach(self._under(choices, self._wants), greatest=True)
                after, most = choices.hit + np.asarray(choices.moves @ attains.values), attains.values[choices.state]
                enough = (its.values[choices.state] >= most - its.error - _ROUNDING) & (after >= most - _ROUNDING)
                follows = self._by_action(enough, False)
            own = reach(self._under(choices, weights), greatest=True)
            short = own.values < attains.values - attains.error - own.error - _ROUNDING
            taken[short] = choices.action[self._allowed][attains.chosen[short]][:, None]
        elif self._stages is None and not self._budget:
            self._check_stands(weights)
        arrays: dict[str, Any] = {"taken": taken, "allowed": allowed.astype(np.uint8)}
        if not self._budget:
            return ShieldedTable(self._policy, arrays)
        least = self._least.values
        needed = np.maximum(reach(self._under(self._its, self._wants), greatest=True).values, least)
        left, spread = self._budget - float(self._start @ least), float(self._start @ (needed - least))
        arrays |= {
            "least": least, "needed": needed, "begin": divided(left, spread, least, needed)[: self._size],
            "worth": self._by_action(self._worth, np.inf),
            "spread": self._by_action(np.asarray(self._its.moves @ (needed - least)), 0.0),
            "follows": follows.astype(np.uint8),
        }  # fmt: skip
        return BudgetedTable(self._policy, arrays)

    def _best(self, allowed: Mask) -> npt.NDArray[np.intp]:
        """Return the best allowed action of each place where the policy may want another."""
        best: npt.NDArray[np.intp] = allowed.argmax(axis=1)
        values: Vector | None = None
        for place in np.flatnonzero(((self._wants > 0) & ~allowed).any(axis=1)).tolist():
            stage, state = divmod(place, self._size)
            these = np.flatnonzero(allowed[place])
            scores = self._policy.scores(state if self._stages is None else Staged(state, stage))
            if scores is None or (scores.by == "chance" and not scores.numbers[these].any()):
                values = self._values() if values is None else values
                best[place] = these[values[state, these].argmax()]
            else:
                best[place] = these[scores.numbers[these].argmax()]
        return best

    def _values(self) -> Vector:
        """Return the value of each action in each state, if the policy goes on after it."""
        model = self._model
        try:
            values = state_values(model, self._policy)
        except ModelError:
            model = model.with_discount(_FAR)
            values = state_values(model, self._policy)
        after = [np.asarray(model.transition_matrix(action) @ values) for action in range(self._count)]
        found: Vector = model.rewards + model.discount * np.stack(after, axis=1)
        return found

    def _solved(self, allowed: Mask) -> npt.NDArray[np.intp]:
        """Return the actions of the model's solution with the allowed actions alone."""
        if self._stages is not None:
            raise ConfigError("a policy by stages is not solved again: solve without a horizon", key="resolve")
        model = self._model
        moves = [model.transition_matrix(action) for action in range(self._count)]
        policy = solve(MDP(moves, model.rewards, discount=model.discount, available=allowed)).policy
        return np.array([policy.action(state) for state in range(self._size)])

    def _check_stands(self, weights: Vector) -> None:
        """Refuse a shield under which a run is certain to end in a state for ever that the policy would leave."""
        stays = [self._under(self._free, each).moves.diagonal() for each in (weights, self._wants)]
        stands = (stays[0] >= 1 - _ROUNDING) & (stays[1] < 1 - _ROUNDING)
        if not stands.any():
            return
        chain = self._under(self._free, weights)
        ends = self._start @ reach(chain._replace(hit=stands.astype(float)), greatest=True).values
        if ends >= 1 - _ROUNDING:
            name = self._model.state_space.names[int(np.flatnonzero(stands)[0])]
            where = f"the robot would stand for ever where the policy goes on, as in {name!r}"
            raise ConfigError(f"{where}: say with keep where it has to go", key="avoid")
