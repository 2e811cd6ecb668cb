"""Shielded policies, which do as another policy does where that is allowed: their base, and those over states.

Over states they are tables, which `mdm.shield` computes: for each state and action that the original wants there, the
action that is taken. With a budget the information state also holds how much of it is left, see `Budgeted`.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from mdm.beliefs import Drawn
from mdm.beliefs.information import restore, snapshot
from mdm.errors import ModelError
from mdm.policies.batch import ProbabilityBatch, TableBatch
from mdm.policies.policy import Kind, StatePolicy
from mdm.policies.table import DeterministicPolicy, QTable, Staged, StagedPolicy, StochasticPolicy

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy.typing as npt

    from mdm.beliefs import Information
    from mdm.models import MDP
    from mdm.models.matrices import Vector
    from mdm.models.space import Space
    from mdm.policies.batch import Batch, Indices
    from mdm.policies.policy import Arrays, Packed, Scores

_ROUNDING = 1e-12
_SPENT = -1.0
"""The budget of a run that goes on without one, by the actions that keep it safest."""
_ORIGINALS = {kind.kind: kind for kind in (DeterministicPolicy, QTable, StagedPolicy, StochasticPolicy)}


class Shielded(Kind):
    """The base of shielded policies, each of which keeps its original.

    Attributes:
        policy: The original.
        avoid: X, the formula of `mdm.verify` that is to be avoided.
        keep: The specification that is kept possible, such as ``reach goal``; None if none is.
        probability: The budget of a run.
    """

    policy: Any
    avoid: str = ""
    keep: str | None = None
    probability: float = 0.0

    def __init__(self, policy: Any) -> None:
        self.policy = policy
        self.num_states, self.num_actions = policy.num_states, policy.num_actions
        self.horizon, self.discount_of = policy.horizon, policy.discount_of

    @property
    def state_space(self) -> Space | None:
        """Of the model, as the original has it."""
        its: Space | None = self.policy.state_space
        return its

    @state_space.setter
    def state_space(self, space: Space | None) -> None:
        self.policy.state_space = space

    def allowed(self, x: Any, /) -> npt.NDArray[np.bool_]:
        """Return for each action whether it is allowed, for the information's ``current``."""
        raise NotImplementedError

    def _chosen(self, x: Any, wants: int) -> int:
        """Return the action that is taken where the original wants some action."""
        raise NotImplementedError

    def _own(self, x: Any) -> Any:
        """Return the original's part of the information."""
        return x

    def action(self, x: Any, /) -> int:
        """Return the original's action for the information's ``current``, or the one taken in its place."""
        return self._chosen(x, self.policy.action(self._own(x)))

    def wanted(self, x: Any, /) -> int | None:
        """Return the action that the original wants, for the information's ``current``; None if that is taken."""
        wants: int = self.policy.action(self._own(x))
        return None if wants == self._chosen(x, wants) else wants

    def scores(self, x: Any, /) -> Scores | None:
        """Return the original's scores, -inf for actions that are not allowed; or the probabilities of those taken."""
        its: Scores | None = self.policy.scores(self._own(x))
        if its is None:
            return None
        if its.by == "chance":
            taken = [self._chosen(x, wants) for wants in range(self.num_actions)]
            return its._replace(numbers=np.asarray(np.bincount(taken, its.numbers, self.num_actions), dtype=float))
        allowed = self.allowed(x)
        upper = None if its.upper is None else np.where(allowed, its.upper, -np.inf)
        return its._replace(numbers=np.where(allowed, its.numbers, -np.inf), upper=upper)

    def mismatch(self, model: MDP) -> str | None:
        """Return why it does not fit a model, as a sentence; None if it fits."""
        text: str | None = self.policy.mismatch(model)
        return text

    def facts(self) -> dict[str, Any]:
        """Return its sizes, and X, by name."""
        told = {"avoids": self.avoid, "keeps": self.keep, "within a budget of": self.probability or None}
        return {**self.policy.facts(), **{name: value for name, value in told.items() if value is not None}}

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.policy!r}: avoids {self.avoid}>"


class ShieldedStates(Shielded):
    """The base of shielded policies over states.

    Args:
        policy: The original.
        arrays: ``taken``, the action for each place and wanted action, and ``allowed``, whether an action is. A place
            is a state, or a stage and a state if the original has stages: H S x A.
    """

    kind: ClassVar[str]
    names: ClassVar[tuple[str, ...]] = ("taken", "allowed")
    input: Literal["state"] = "state"
    num_states: int

    def __init__(self, policy: Any, arrays: Arrays) -> None:
        super().__init__(policy)
        size = (policy.horizon or 1) * policy.num_states
        self._arrays = {name: arrays[name] for name in self.names}
        self._taken, self._allowed = arrays["taken"], arrays["allowed"]
        if any(each.shape != (size, self.num_actions) for each in (self._taken, self._allowed)):
            raise ModelError(f"a shield's arrays are not of the {size} x {self.num_actions} numbers of its policy")
        if not ((self._taken >= 0) & (self._taken < self.num_actions)).all():
            raise ModelError(f"an entry of the shield is no action: these are 0 to {self.num_actions - 1}")

    def place(self, x: Any, /) -> int:
        """Return the row of a state, or of a state and a stage."""
        x = x.by if isinstance(x, Drawn) else x
        state, stage = x if isinstance(x, Staged) else (x, 0)
        if isinstance(state, str) and self.state_space is not None:
            state = self.state_space.index(state)
        return int(min(stage, (self.horizon or 1) - 1) * self.num_states + state)

    @property
    def seed(self) -> Callable[[int | None], None]:
        """Restart the draws from a seed; of policies that draw alone."""
        own = copy.copy(self.policy)
        reseed = own.seed  # has none if it does not draw

        def restart(seed: int | None) -> None:
            reseed(seed)
            self.policy = own

        return restart

    def packed(self) -> Packed | None:
        """Return its sizes and arrays; None if files cannot hold the original."""
        if type(self.policy) not in _ORIGINALS.values():
            return None
        sizes, arrays = self.policy.packed()
        texts = np.frombuffer("\0".join((self.policy.kind, self.avoid, self.keep or "")).encode(), dtype=np.uint8)
        its = {"texts": texts, "probability": np.array([self.probability]), **self._arrays}
        return sizes, {**arrays, **{f"shield_{name}": array for name, array in its.items()}}

    @classmethod
    def unpacked(cls, sizes: Mapping[str, int], arrays: Arrays, seed: int | None) -> Self:
        """Return a packed policy."""
        kind, avoid, keep = arrays["shield_texts"].tobytes().decode().split("\0")
        if kind not in _ORIGINALS:
            raise ModelError(f"a shield is of no policy of kind {kind[:40]!r}")
        original: Any = _ORIGINALS[kind].unpacked(sizes, arrays, seed)
        made = cls(original, {name: arrays[f"shield_{name}"] for name in cls.names})
        made.avoid, made.keep, made.probability = avoid, keep or None, float(arrays["shield_probability"][0])
        return made

    def parameters(self) -> list[Any]:
        """Return all that decides besides the information, as numbers, strings, lists and arrays."""
        return [self.kind, self.policy.parameters(), *self._arrays.values()]


class ShieldedTable(ShieldedStates, StatePolicy):
    """A policy over states that never takes an action that is not allowed. `mdm.shield` makes it.

    Example::

        safe = mdm.shield([1, 1], "tiger.pomdp", avoid="tiger-left and action = open-left")
        safe.action(0), safe.wanted(0)  # 2, 1
    """

    kind = "shielded"
    form = "a shielded policy over states"

    def __init__(self, policy: Any, arrays: Arrays) -> None:
        super().__init__(policy, arrays)
        if policy.table is not None:
            self.table = self._taken[np.arange(self.num_states), policy.table].tolist()

    def information(self, model: MDP | None) -> Information:
        """Return that of the original."""
        its: Information = self.policy.information(model)
        return its

    def allowed(self, x: Any, /) -> npt.NDArray[np.bool_]:
        """Return for each action whether it is allowed, for the information's ``current``."""
        return np.asarray(self._allowed[self.place(x)] > 0)

    def _chosen(self, x: Any, wants: int) -> int:
        return int(self._taken[self.place(x), wants])

    def weights(self, stage: int = 0) -> Vector:
        """Return the probability of each action in each state, A x S."""
        given: Vector = self.policy.weights(stage)
        taken = self._taken[stage * self.num_states : (stage + 1) * self.num_states].T
        weights = np.zeros_like(given)
        np.add.at(weights, (taken, np.broadcast_to(np.arange(self.num_states), taken.shape)), given)
        return weights

    def batch(self, model: MDP) -> Batch | None:
        """Return its decisions for a batch of episodes; None if it draws by stages."""
        weights = np.stack([self.weights(stage) for stage in range(self.horizon or 1)])
        if (weights.max(axis=1) == 1).all():
            return TableBatch(weights.argmax(axis=1))
        return ProbabilityBatch(weights[0]) if self.horizon is None else None


class Budgeted(NamedTuple):
    """The original's information, and the budget left: the most probability of X from here on."""

    by: Any
    budget: float


class BudgetedTable(ShieldedStates):
    """A policy over states that spends a budget on actions that are not the safest. `mdm.shield` makes it.

    An action a is taken in state s if the budget b left covers w(s, a), the least probability of X behind it: that it
    reaches X at once, and sum P(s'|s, a) m(s') with m, the least probability from s'. The rest, b - w(s, a), is
    divided over the successors by the original's need there, u(s') - m(s') with its own probability u; more than that
    by equal parts::

        b(s') = m(s') + (u(s') - m(s')) min(1, d) + max(0, b - w(s, a) - e),  d = (b - w(s, a)) / e,
        e = sum P(s'|s, a) (u(s') - m(s')).

    So sum P(s'|s, a) b(s') <= b, and b(s') >= m(s'): the budget is a supermartingale that bounds the probability of X
    from each state on, and that of a whole run by the first one. Where the budget does not cover the original's action,
    the action of the shield without a budget is taken, for which w(s, a) = m(s). With ``keep`` that is so from then on,
    and also where the original attains less of "keep or X" than that shield, or would lessen it: the run then attains
    ``keep`` at most by the budget less probably than without one.

    Example::

        safe = mdm.shield([1, 1], "tiger.pomdp", avoid="tiger-left and action = open-left", probability=0.01)
        controller = mdm.Controller(safe, "tiger.pomdp")
        controller.see("tiger-left").action_name, safe.wanted(controller.information.current)  # 'open-right', 1
    """

    kind = "budgeted"
    form = "a shielded policy over states, with a budget"
    names = ("taken", "allowed", "least", "needed", "worth", "spread", "follows", "begin")

    def __init__(self, policy: Any, arrays: Arrays) -> None:
        super().__init__(policy, arrays)
        its = (arrays[name] for name in self.names[2:])
        self._least, self._needed, self._worth, self._spread, self._follows, self.begin = its

    def information(self, model: MDP | None) -> BudgetedState:
        """Return the state, and the budget."""
        return BudgetedState(self.policy.information(model), self)

    def _own(self, x: Budgeted) -> Any:
        return x.by

    def possible(self) -> npt.NDArray[np.bool_]:
        """Return the actions that it may take in each state, at any budget and stage: S x A."""
        found = np.zeros((self.num_states, self.num_actions), dtype=bool)
        for stage in range(self.horizon or 1):
            state, wants = np.nonzero(self.policy.weights(stage).T)
            found[state, wants] = True
            found[state, self._taken[stage * self.num_states + state, wants]] = True
        return found

    def allowed(self, x: Budgeted, /) -> npt.NDArray[np.bool_]:
        """Return for each action whether it is the safest, or the budget left covers it."""
        place = self.place(x.by)
        return np.asarray(self.covers(place, slice(None), x.budget) | (self._allowed[place] > 0))

    def _chosen(self, x: Budgeted, wants: int) -> int:
        return int(self.taken(self.place(x.by), wants, x.budget))

    def covers(self, places: Any, wants: Any, budgets: Any) -> npt.NDArray[np.bool_]:
        """Return whether budgets cover the actions that the original wants at some places."""
        return np.asarray((self._follows[places, wants] > 0) & (self._worth[places, wants] <= budgets + _ROUNDING))

    def taken(self, places: Any, wants: Any, budgets: Any) -> Indices:
        """Return the actions that are taken for those that the original wants at some places."""
        return np.asarray(np.where(self.covers(places, wants, budgets), wants, self._taken[places, wants]))

    def left(self, budgets: Any, before: Any, wants: Any, actions: Any, now: Any) -> Vector:
        """Return the budgets left after actions between two places, if the original wanted some at the first."""
        left, spread = budgets - self._worth[before, actions], self._spread[before, actions]
        goes_on = budgets >= 0 if self.keep is None else self.covers(before, wants, budgets)
        return np.where(goes_on, divided(left, spread, self._least[now], self._needed[now]), _SPENT)

    def batch(self, model: MDP) -> Batch:
        """Return its decisions for a batch of episodes."""
        return BudgetedBatch(self)


def divided(left: Any, spread: Any, least: Vector, needed: Vector) -> Vector:
    """Return the budgets of successors, of which `BudgetedTable` has the formula."""
    share = np.where(spread > 0, np.clip(left, 0, spread) / np.where(spread > 0, spread, 1), 0)
    budgets: Vector = np.minimum(1.0, least + share * (needed - least) + np.maximum(0.0, left - spread))
    return budgets


class BudgetedBatch:
    """The decisions of a batch of episodes, each with a budget.

    Args:
        policy: The policy.
    """

    def __init__(self, policy: BudgetedTable) -> None:
        self._policy, self._stage = policy, 0
        weights = [policy.policy.weights(stage) for stage in range(policy.horizon or 1)]
        self._drawing = ProbabilityBatch(np.concatenate(weights, axis=1))

    def begin(self, states: Indices, numbers: Vector) -> Indices:
        """Return the first actions."""
        self._stage, self._places, self._budgets = 0, states.copy(), self._policy.begin[states]
        self._wants = self._drawing.begin(states, numbers)
        return self._policy.taken(states, self._wants, self._budgets)

    def next(self, episodes: Indices, states: Indices, actions: Indices, seen: Indices, numbers: Vector) -> Indices:
        """Return the next actions."""
        policy = self._policy
        self._stage = min(self._stage + 1, (policy.horizon or 1) - 1)
        places = self._stage * policy.num_states + states
        budgets, before, wanted = (each[episodes] for each in (self._budgets, self._places, self._wants))
        budgets, wants = policy.left(budgets, before, wanted, actions, places), self._drawing.begin(places, numbers)
        self._budgets[episodes], self._places[episodes], self._wants[episodes] = budgets, places, wants
        return policy.taken(places, wants, budgets)

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        """Drop the other episodes."""
        self._places, self._budgets, self._wants = self._places[which], self._budgets[which], self._wants[which]


class BudgetedState:
    """A state that is observed, and the budget left.

    Args:
        inner: The original's information.
        policy: The policy.

    Attributes:
        of: The information without the random numbers of an original that draws.
    """

    takes: Literal["state"] = "state"

    def __init__(self, inner: Any, policy: BudgetedTable) -> None:
        self._inner, self._policy = inner, policy
        self._budget: float | None = None
        self.of: Any = getattr(inner, "of", inner)
        self.expected, self.horizon = getattr(inner, "expected", None), policy.horizon

    @property
    def state(self) -> int | None:
        """The state's index; None until one is seen."""
        state: int | None = self.of.state
        return state

    @property
    def draws(self) -> str:
        """The state of the original's random numbers; empty if it draws none."""
        return getattr(self._inner, "draws", "")

    @draws.setter
    def draws(self, draws: str) -> None:
        self._inner.draws = draws

    @property
    def current(self) -> Budgeted | None:
        """The original's information, and the budget left; None until a state is seen."""
        return None if self._budget is None else Budgeted(self._inner.current, self._budget)

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Begin a run, with the whole budget."""
        self._inner.reset(belief)
        self._budget = None

    def update(self, action: int | None, observation: int | None) -> float:
        """Set the state, and spend on the action before; nothing is spent where no state is seen. Return 1."""
        before, its = self.current, self._policy
        self._inner.update(action, observation)
        if before is None and self.state is not None:
            self._budget = float(its.begin[self.state])
        elif before is not None and action is not None and observation is not None:
            wants, now = its.policy.action(before.by), its.place(self._inner.current)
            self._budget = float(its.left(before.budget, its.place(before.by), wants, action, now))
        return 1.0

    def snapshot(self) -> Any:
        """Return the information and the budget."""
        return [snapshot(self._inner), self._budget]

    def restore(self, snapshot: Any) -> None:
        """Restore a snapshot.

        Raises:
            ModelError: If the budget is none; nothing is changed.
        """
        of, budget = snapshot
        if budget is not None and budget != _SPENT and not 0 <= budget <= 1:
            raise ModelError(f"{budget!r} is no budget from 0 to 1")
        restore(self._inner, of)
        self._budget = budget
