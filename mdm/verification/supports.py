"""Supports of a POMDP's belief from which X can be avoided for ever, and a goal reached almost surely on the way.

Whether something is certain depends on the support of the belief alone. The supports that can follow each other are the
states of a graph, in which the greatest fixed point of safe actions comes first. Of these a support keeps the goal if
each of its states can reach it by actions that stay in such supports: whoever draws such actions at random reaches the
goal with probability 1, and where that fails no policy does (K. Chatterjee, L. Doyen and T. A. Henzinger, *Qualitative
analysis of partially-observable Markov decision processes*, MFCS 2010; S. Junges, N. Jansen and S. A. Seshia,
*Enforcing almost-sure reachability in POMDPs*, CAV 2021). Cost: supports times actions times their states' successors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_array, hstack

from mdm.errors import ConfigError, ModelError
from mdm.models import POMDP
from mdm.models.dynamics import Dynamics, dense
from mdm.models.matrices import csr
from mdm.policies.policy import observable
from mdm.policies.supported import ShieldedBelief, ShieldedController, ShieldedSearch, SupportMask, widened
from mdm.solvers.bounds import known_state_values
from mdm.verification.chains import chain_of_policy
from mdm.verification.choices import Choices, Graph
from mdm.verification.reaching import reach, steps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mdm.models import MDP, POMDP
    from mdm.models.matrices import Matrix
    from mdm.models.specification import Mask
    from mdm.policies import FiniteStateController
    from mdm.verification.choices import Indices

MOST = 20_000
"""The most supports that are enumerated."""
_ENTRIES = 5_000_000
"""The most successors of their states."""
_SMALL = 1e-14
"""Smaller probabilities of a detection in the end are rounding errors."""
SLOWEST = 0.05
"""By how many steps an action has to shorten the expected time to the goal."""
_DISCOUNT = 0.99
"""The largest discount of the values by which actions are compared where a policy has no scores."""
_EPISODES, _PHASES, _GOLDEN = 200, 32, 0.6180339887498949
"""Simulated episodes; nodes that take states for the true one in turn; the step of the turn."""


class Supports:
    """The supports that may be met, K in all, and their states behind each other, N in all; see `SupportMask`.

    States that only the goal leads to are behind it. A state that is also on the way counts as reached only where the
    goal is reached again; a goal that is met between two observations does not count.

    Args:
        model: The model.
        avoid: X, S x (A + 1), as `Specification.target` has it.
        keep: The goal in the same form; None where there is none.
        margin: Transitions that may happen besides the model's, as state, action and next state. They do not help to
            reach the goal.

    Attributes:
        starts: As a mask has them, like ``states``, ``allowed`` and ``gain``; an action gains only if it shortens the
            way of a policy that draws allowed ones by more than `SLOWEST` steps, and nothing behind a goal.
        after: The support after each support, action and observation, K x A x (O + 1), of which the last is that of
            nothing; -1 where there is none, or the action is not safe at once.
        first: The supports in which an episode may begin.
        keeps: In which the goal can be reached for certain, K; without a goal those in which X can be kept out. Of the
            others the allowed actions are those that keep X out.
        possible: Whether allowed actions reach the goal from the start with a probability above 0.
        time: The expected time to the goal of random allowed actions from the start; infinite where it is not certain.
        ahead: An action that leads each state of a support on to the goal with a probability above 0, N; else -1.

    Raises:
        ModelError: If the supports are too many to enumerate.
    """

    def __init__(
        self, model: POMDP, avoid: Mask, keep: Mask | None = None, margin: Sequence[tuple[int, int, int]] = ()
    ) -> None:
        self._explore(model, avoid, margin)
        size, count, _ = self.after.shape
        known, places = self.after.reshape(size * count, -1) >= 0, np.arange(size * count)
        nexts = self.after.reshape(known.shape)[known]
        moves = csr((np.ones(len(nexts)), nexts, np.append(0, known.sum(axis=1).cumsum())), (len(places), size))
        shut = ~known.any(axis=1)
        choices = Choices(moves, shut.astype(float), np.zeros(len(places)), *np.divmod(places, count))
        self._graph = Graph(choices)
        self.keeps, opened = self._graph.avoiding()
        self.allowed = opened.reshape(-1, count)
        self.possible, self.time, self.ahead = True, np.inf, np.full(len(self.states), -1)
        self.gain = np.zeros((len(self.states), count))
        if keep is not None:
            self._keep(choices, keep[:, :-1][self.states], _behind(model, keep)[self.states])

    def _explore(self, model: POMDP, avoid: Mask, margin: Sequence[tuple[int, int, int]]) -> None:
        """Enumerate the supports, and the transitions of pairs of a support and one of its states."""
        dynamics = Dynamics(model)
        size, count, nothing = dynamics.num_states, dynamics.num_actions, dynamics.num_observations
        safe = Graph(Choices.of_model(model, avoid, None)).avoiding()[0]
        shut = avoid[:, :-1] if model.available is None else avoid[:, :-1] | ~model.available
        real = moves = [_moves(model, dynamics, action) for action in range(count)]
        if margin:
            wider = widened(model, margin)
            moves = [_moves(wider, Dynamics(wider), action) for action in range(count)]
        supports: dict[bytes, int] = {}
        pending: list[Indices] = []
        after: list[Indices] = []
        entries: list[tuple[Indices, Indices, Indices]] = [3 * (np.empty(0, np.int64),)]

        def number(states: Indices) -> int:
            found = supports.setdefault(states.tobytes(), len(pending))
            if found == len(pending):
                pending.append(states)
            return found

        begins = {model.belief_at_start(each).tobytes() for each in np.flatnonzero(model.initial_belief).tolist()}
        self.first = sorted({number(np.flatnonzero(np.frombuffer(each))) for each in begins})
        total = place = 0
        for states in pending:  # it grows meanwhile
            after.append(np.full((count, nothing + 1), -1))
            for action, (rows, unseen) in enumerate(moves):
                its = rows[states]
                symbols, targets = np.divmod(its.indices.astype(np.int64), size)
                if not len(targets) or shut[_until_seen(states, unseen), action].any() or not safe[targets].all():
                    continue
                keys = np.unique(symbols * size + targets)
                seen, cuts = np.unique(keys // size, return_index=True)
                parts = np.split(keys % size, cuts[1:])
                if seen[-1] == nothing:  # the tracker predicts
                    parts[-1] = np.unique(targets)
                after[-1][action, seen] = [number(part) for part in parts]
                its = real[action][0][states]
                symbols, targets = np.divmod(its.indices.astype(np.int64), size)
                sources = (place + np.repeat(np.arange(len(states)), np.diff(its.indptr))) * count + action
                entries.append((sources, after[-1][action, symbols] * size + targets, its.data))
                total += len(targets)
            place += len(states)
            if len(pending) > MOST or total > _ENTRIES:
                raise ModelError(
                    f"the belief may have more than {min(len(pending), MOST):,} supports, which are too many to "
                    "enumerate: shield a policy of a smaller model"
                )
        self.starts, self.states = np.cumsum([0, *map(len, pending)]), np.concatenate(pending)
        self.after = np.array(after)
        self._of = np.repeat(np.arange(len(pending)), np.diff(self.starts))
        sources, targets, chances = (np.concatenate(part) for part in zip(*entries, strict=True))
        pairs = np.searchsorted(self._of * size + self.states, targets)
        shape = len(self.states) * count, len(self.states)
        self._moves = coo_array((chances.astype(float), (sources, pairs)), shape).tocsr()

    def _keep(self, choices: Choices, reached: Mask, behind: Mask) -> None:
        """Narrow the actions to those that keep the goal certain, where it is; ``reached`` is for pairs and actions."""
        count, size = reached.shape[1], len(self.states)
        ends = (reached | behind[:, None]).ravel()
        moves = self._moves.copy()
        moves.data[np.repeat(ends, np.diff(moves.indptr))] = 0
        moves.eliminate_zeros()
        of, action = np.divmod(np.arange(size * count), count)
        pairs = Choices(moves, ends.astype(float), np.zeros(len(ends)), of, action)
        graph, opened, sure = Graph(pairs), self.allowed, self.keeps
        none, begins = np.zeros(size, dtype=bool), np.isin(self._of, self.first)
        self.possible = bool(graph.attracted(none, ends, opened=opened[self._of].ravel())[0][begins].any())
        while True:
            found, by = graph.attracted(none, ends, opened=opened[self._of].ravel())
            going = sure & np.logical_and.reduceat(found, self.starts[:-1])
            sure = ~self._graph.attracted(~going, choices.hit > 0, every=True)[0]
            opened = ((choices.hit == 0) & ~choices.lead_to(~sure) & sure[choices.state]).reshape(opened.shape)
            if (sure == going).all() and (found | ~sure[self._of]).all():
                break
        self.allowed, self.keeps = np.where(sure[:, None], opened, self.allowed), sure
        its = sure[self._of]
        if not its.any():
            return
        self.ahead = np.where(its & ~behind, action[by], -1)
        weights = (opened / np.maximum(opened.sum(axis=1, keepdims=True), 1))[self._of]
        drawing = csr((weights.ravel(), np.arange(len(ends)), np.arange(size + 1) * count), (size, len(ends)))
        drawn, hit = csr(drawing @ moves)[its][:, its], (drawing @ ends)[its]
        times = np.zeros(size)
        every = np.arange(len(hit))
        times[its] = steps(Choices(drawn, hit, np.zeros(len(hit)), every, every), greatest=True).values
        times[behind] = 0
        if sure[self.first].all():
            self.time = float(times[begins].max())
        gain = times[:, None] - np.asarray(moves @ times).reshape(size, count) - SLOWEST
        self.gain = np.where((its & ~behind)[:, None], gain, 0)


def _moves(model: POMDP, dynamics: Dynamics, action: int) -> tuple[Matrix, Matrix | None]:
    """Return P(s', o | s, a) up to an observation, S x (O + 1) S', and the steps without one, or None."""
    size, nothing = dynamics.num_states, dynamics.num_observations
    joints = dynamics.joint(action).side_by_side(nothing + 1)
    if not model.waits_in(action):
        return joints, None
    blocks = [joints[:, each * size : (each + 1) * size] for each in range(nothing + 1)]
    blind = [each for each in (model.false_negative, nothing) if each is not None]
    unseen = csr(sum(blocks[each] for each in blind))
    for each in range(nothing + 1):
        whole = np.zeros((size, size)) if each in blind else model.resolvent(action).values(dense(blocks[each]))
        blocks[each] = csr(np.where(whole > _SMALL, whole, 0))
    return csr(hstack(blocks)), unseen


def _until_seen(states: Indices, unseen: Matrix | None) -> Indices:
    """Return the states in which an action may be before something is seen."""
    while unseen is not None:
        more = np.union1d(states, unseen[states].indices)
        if len(more) == len(states):
            break
        states = more
    return states


def _behind(model: POMDP, goal: Mask) -> Mask:
    """Return which states only the goal leads to."""
    its = Choices.of_model(model, goal, None)
    met, more = np.zeros(its.size, dtype=bool), model.initial_belief > 0
    while (more & ~met).any():
        met = met | more
        more = np.asarray(met[its.state].astype(float) @ its.moves) > 0
    return ~met


# -- Shields -----------------------------------------------------------------------------------------------------------


def over_supports(
    policy: Any, model: MDP, avoid: Mask, keep: Mask | None = None, margin: Sequence[tuple[int, int, int]] = ()
) -> Any:
    """Return a policy over beliefs, a search or a finite-state controller, shielded; see `Supports` and `mdm.shield`.

    Where the mask alone brings 200 simulated episodes to the goal, within ten times the time of random allowed actions,
    nothing else is asked of the actions.

    Raises:
        ModelError: If X cannot be kept out for certain, or the supports are too many.
        ConfigError: If the shield makes the goal impossible.
    """
    from mdm.simulation.batch import outcomes  # noqa: PLC0415 - slow to import

    seen = observable(model)
    if margin and seen.event_observations:
        raise ModelError("a margin needs observations of states: those of events are not known for its transitions")
    found = Supports(seen, avoid, keep, margin)
    if not found.allowed[found.first].any(axis=1).all():
        why = "from the start no policy that goes by the observations avoids it for certain"
        raise ModelError(f"{why}: the shield allows nothing")
    if not found.possible:
        raise ConfigError("the shield leaves no way to the goal: no actions that supports allow lead there", key="keep")
    choices = Choices.of_model(model, avoid, None)
    least = reach(choices, greatest=False).values
    risk = np.full(avoid[:, :-1].shape, np.inf)
    risk[choices.state, choices.action] = choices.hit + choices.moves @ least
    dynamics = Dynamics(model)
    dynamics.discount = min(dynamics.discount, _DISCOUNT)
    mask = SupportMask(found.starts, found.states, found.allowed, None, risk, known_state_values(dynamics))
    if policy.input == "observation":
        controller = _controller(policy, seen, found, mask, keep)
        controller.margin = margin
        return controller
    kind = ShieldedSearch if getattr(policy, "deliberates", False) else ShieldedBelief
    shielded, given = kind(policy, mask, margin), dict[str, Any](episodes=_EPISODES, seed=0, progress=None)
    longest = 1_000 if found.time == np.inf else 100 + 10 * int(min(found.time, 1_000))
    if keep is not None and (
        kind is ShieldedSearch or not outcomes(model, shielded, keep.astype(float), longest, **given).returns.all()
    ):
        mask.gain = found.gain
    return shielded


def _controller(policy: Any, model: POMDP, found: Supports, mask: SupportMask, keep: Mask | None) -> ShieldedController:
    """Return a controller over the pairs of its nodes and supports.

    Nodes from which the goal is impossible are left for others that count to 32: each of these takes one of the states
    of the support for the true one, and leads it on.
    """
    if len(policy.controllers) > 1 or len(found.first) > 1:
        why = "a controller of each agent, or one that sees the first state, does not go by one support"
        raise ModelError(f"{why}: shield a policy over beliefs")
    shielded, labels = _product(policy.controllers[0], model, found, mask, set())
    chain = None if keep is None else chain_of_policy(model, shielded)
    if chain is None or keep is None:
        return shielded
    never = Graph(Choices.of_chain(chain.moves, chain.chances(keep), np.zeros(len(chain.state)))).impossible()
    never = never.reshape(-1, len(model.state_space))
    stuck = set()
    for place, (node, number, _) in enumerate(labels):
        its = slice(found.starts[number], found.starts[number + 1])
        if never[place, found.states[its][found.ahead[its] >= 0]].any():
            stuck.add((node, number))
    return _product(policy.controllers[0], model, found, mask, stuck)[0] if stuck else shielded


def _product(
    plan: FiniteStateController, model: POMDP, found: Supports, mask: SupportMask, stuck: set[tuple[int, int]]
) -> tuple[ShieldedController, list[tuple[int, int, int]]]:
    """Return the controller, and of each of its nodes the plan's, the support, and the count from 1 on, or 0."""
    begin = plan.start if plan.values is None else plan.start_node(model.initial_belief)
    first = begin, found.first[0], int((begin, found.first[0]) in stuck)
    labels, numbers = [first], {first: 0}
    actions: list[int] = []
    successors: list[list[int | None]] = []
    allowed: list[Mask] = []
    for node, number, phase in labels:  # it grows meanwhile
        its = slice(found.starts[number], found.starts[number + 1])
        states, ahead = found.states[its], found.ahead[its][found.ahead[its] >= 0]
        allowed.append(mask.at(states, np.full((1, len(states)), 1 / len(states)))[0])
        action = plan.actions[node]
        if phase and len(ahead):
            action = int(ahead[int(phase * _GOLDEN % 1 * len(ahead))])
        elif not allowed[-1][action]:
            action = int(np.where(allowed[-1], mask.values[states].mean(axis=0), -np.inf).argmax())
        row: list[int | None] = [None] * plan.num_observations
        for symbol, after in enumerate(found.after[number, action, :-1].tolist()):
            if after < 0 or (plan.is_last(node) and not phase):
                continue
            then = plan.successors[node][symbol]
            then = node if then is None or phase else then
            label = then, after, phase % _PHASES + 1 if phase else int((then, after) in stuck)
            row[symbol] = numbers.setdefault(label, len(labels))
            if row[symbol] == len(labels):
                labels.append(label)
        actions.append(action)
        successors.append(row)
        if len(labels) > MOST:
            raise ModelError(f"the shielded controller has more than {MOST:,} nodes: shield one of fewer nodes")
    wanted = [None if phase else plan.actions[node] for node, _, phase in labels]
    return ShieldedController(plan, actions, successors, wanted, np.array(allowed)), labels
