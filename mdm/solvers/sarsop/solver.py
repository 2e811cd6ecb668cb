"""SARSOP: point-based value iteration on the beliefs that optimal policies reach.

Trials go from the initial belief down to beliefs that are likely under the best policy, by the action of the greatest
upper bound and the observation of the greatest uncertainty, as deep as an improvement of the initial belief's value can
be expected (selective deep sampling). Bounds are backed up along them: alpha vectors below, points over the fast
informed bound above (H. Kurniawati, D. Hsu and W. S. Lee, *SARSOP: efficient point-based POMDP planning by
approximating optimally reachable belief spaces*, RSS 2008; with mixed observability S. C. W. Ong, S. W. Png, D. Hsu and
W. S. Lee, IJRR 29, 2010). Beliefs are sparse, equal ones are one, and an action is expanded only when its bound is the
greatest.

Cost of a backup: the entries of one action's T and O in one block, and for each outcome its support times the vectors
and points that are new to it.
"""

from __future__ import annotations

import warnings
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from mdm.compilation import can_compile, may_compile, plain
from mdm.errors import ModelError, ModelWarning
from mdm.models import POMDP
from mdm.models.dynamics import Dynamics
from mdm.policies import AlphaVectors, MixedAlphaVectors
from mdm.solvers.bounds import blind_values, informed_values
from mdm.solvers.joint_dynamics import JointDynamics
from mdm.solvers.mdp.policy_iteration import remedy
from mdm.solvers.sarsop.condensation import CHOICE, EVALUATION, Condensed, Kernels, Vectors, condensed
from mdm.solvers.sarsop.graph import (
    EDGES,
    LINKS,
    NODES,
    OUTCOMES,
    POINTS,
    VALUES,
    VECTORS,
    WEIGHTS,
    bytes_of,
    bytes_of_arrivals,
    grown,
    lacking,
    layout_of,
    new_graph,
    new_scratch,
    room_for,
    rows_of,
    without_beliefs,
)
from mdm.solvers.sarsop.pruning import (
    bytes_to_forget_nodes,
    bytes_to_need_vectors,
    forget_nodes,
    needed_vectors,
    parts_of,
    prune_points,
    prune_vectors,
)
from mdm.solvers.solution import Limits, makes

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models.matrices import Vector
    from mdm.solvers.solution import Solution

_STEPS = "mdm.solvers.sarsop.search"
_BINS = 50
_BLIND_TIME = 0.1
"""The part of the time that is left for the values of single actions."""
_DEPTH, _LEAST_DEPTH = 1000, 16
"""Steps of a trial at most, and those that it may have however little time is left."""
_SLACK = 1e-12
"""Slack of the upper bound for rounding, as a share of the values."""
_ROUNDING = 4e-12
"""The bounds come no nearer than this share of the values: the slack for rounding."""
_LEAST_VECTORS = 200
_LEAST_NODES = 50_000
_CONDENSATION = 0.5, 0.4
"""The seconds, and the part of the time so far, that a policy may take to be made small: the larger of them."""
_RESERVED = 0.4
"""The part of the time so far that is left of a time limit for it."""
_BEYOND = 0.3
"""The seconds that it may take beyond a time limit."""
_FIRST_PLAN, _LEAST_PLAN = 1.0, 0.2
"""The seconds before a plan is looked for, and that the search for one may take at least."""
_PLANS = 0.15
"""The part of the time that goes into plans; half of it where they are of no use."""
_FROM_ALL = 0.8
"""The part of the time that is left for a plan of all vectors; the rest is for one of their known followers."""
_SMALLER = 0.5
"""The part of the vectors that a plan has at most where it is expected to fit into memory."""
_GAIN = 1e-3
"""The least raise of the lower bound by a plan, as a share of the gap, to be taken into the search."""
_SHORT = 1.0
"""The seconds that a small model has to be solved in by plain Python before compiled code is called for."""
_SMALL = 5_000
"""The entries of T and O up to which a model counts as small."""
_FEWER = 5e-3, 5e-4, 5e-5, 0.0
"""The loss of a belief for a vector less, as shares of the gap: each is tried where the one before is of no use."""


@makes(AlphaVectors, mixed=MixedAlphaVectors)
def sarsop(model: POMDP, *, limits: Limits | None = None, whole: bool = False) -> Solution:
    """Solve a POMDP.

    Where factors of the state are fully observed, the model `POMDP.revealed` is solved, and the bounds are for an agent
    that sees them from the start.

    Args:
        model: The model; its observations depend on states or are events. Factored ones are flattened.
        limits: When to stop, and where to report.
        whole: Whether the policy has all vectors that its value was built from, by backups alone. By default plans are
            looked for beside these, which raises the lower bound sooner, and the policy has the few vectors that a good
            plan uses, with values that hold for these alone: it is certified again.

    Raises:
        ModelError: If the discount is 1.
    """
    if model.discount >= 1:
        raise ModelError(f"SARSOP needs a discount below 1, or its bounds never meet: {remedy(model)}")
    _check_compiler()
    with Limits() if limits is None else limits as run:
        model = model.revealed()
        end = run.end if whole else run.end / (1 + _RESERVED)
        search = _Search(model, run, whole=whole)
        lower, upper = search.bounds()
        while not run.ends(lower, upper, iterations=search.backups, size=search.size):
            search.compile(run)
            search.run(run, end)
            if not whole:
                search.condense(run)
                if 0 <= run.remaining < _RESERVED * run.seconds:
                    run.reason = "time"
            lower, upper = search.bounds()
            if run.gap < upper - lower <= search.rounding:
                run.reason = "converged"
        if not whole:
            search.prune(run)
            search.learn_followers(run)
        search.forget_beliefs()
        small = None if whole else search.condensed(run, lower, upper)
        vectors, lower = (search.whole(), lower) if small is None else small
        policy = search.policy(vectors)
        return run.solution(policy, "sarsop", lower, upper, iterations=search.backups, size=len(vectors.actions))


@cache
def _check_compiler() -> None:
    if not may_compile():
        text = "SARSOP runs uncompiled, slower by far on all but small models: pip install numba"
        warnings.warn(text, ModelWarning, stacklevel=4)


def _fastest() -> Any:
    """Return the steps compiled, now, or loaded; without a compiler as they are."""
    return _compiled() if can_compile() else plain(_STEPS)


@cache
def _compiled() -> Any:
    from mdm.solvers.sarsop import search  # noqa: PLC0415 - imports numba

    tiny = POMDP([np.eye(2)] * 2, [np.eye(2)] * 2, np.eye(2), discount=0.5)
    limits = Limits(gap=0.0)
    first = _Search(tiny, limits, search)
    first.bounds()
    first.run(limits)
    first.condensed(limits, 0.0, 0.0)
    return search


class _Search:
    """The state of a run."""

    def __init__(self, model: POMDP, limits: Limits, steps: Any = None, *, whole: bool = False) -> None:
        self._model = model
        self._whole = whole
        dynamics = Dynamics(model)
        detections = JointDynamics(dynamics, model.false_negative) if dynamics.moves_by_joints else None
        if detections is not None and (size := bytes_of_arrivals(detections)) > limits.room:
            text = f"SARSOP would need {size / 1e6:.0f} MB for the steps without a detection: take perseus"
            raise ModelError(f"{text}, or give it more memory (--memory)")
        self._layout, self._order = layout_of(model, dynamics, detections)
        entries = len(self._layout.transitions.values) + len(self._layout.observations.values)
        self._is_plain = steps is None and entries <= _SMALL
        self._steps = steps
        if self._is_plain:
            self._steps = plain(_STEPS)
        elif steps is None:
            with limits.uncounted():
                self._steps = _fastest()
        blind = blind_values(dynamics, limits.part(_BLIND_TIME))[:, self._order]
        bound = None if detections is None else detections.informed
        informed = informed_values(dynamics, limits, bound)[self._order].T
        self._informed = np.ascontiguousarray(informed + _SLACK * np.abs(informed).max())
        self._graph = new_graph(self._layout, _BINS)
        self._scratch = new_scratch(self._layout, _DEPTH)
        self._needed = room_for(self._layout)
        self._room = np.array([self._needed[count] for count in range(8)], dtype=np.int64)
        self.backups = 0
        self._budget = 16
        self._pace = np.inf
        self._next_plan = _FIRST_PLAN
        self._tries = 0
        self._after: npt.NDArray[np.intp] | None = None
        self._start(blind)
        self._kept_vectors = self.size
        self._kept_points = 0
        self._kept_nodes = 0

    def _start(self, blind: Vector) -> None:
        layout = self._layout
        num_blocks = len(layout.first_state) - 1
        for action, values in enumerate(blind):
            for block in range(num_blocks):
                self._grow()
                vector = self._steps.add_vector(layout, self._graph, block, action)
                # It goes on in every block that the action leads to.
                self._link(vector, action * num_blocks + np.arange(num_blocks))
                at = self._graph.first_value[vector]
                part = values[layout.first_state[block] : layout.first_state[block + 1]]
                self._graph.values[at : at + len(part)] = part
                default = self._graph.default_vector[block]
                if default < 0 or part.mean() > self._part(default).mean():
                    self._graph.default_vector[block] = vector
        belief = self._model.initial_belief[self._order]
        roots, shares = [], []
        for block in np.unique(layout.block[belief > 0]):
            begin, end = layout.first_state[block : block + 2]
            places = np.flatnonzero(belief[begin:end])
            self._scratch.entry_place[: len(places)] = places
            self._scratch.entry_weight[: len(places)] = belief[begin:end][places]
            share = float(belief[begin:end].sum())
            self._grow()
            entries = 0, len(places), share
            roots.append(self._steps.add_node(layout, self._graph, self._scratch, self._informed, int(block), *entries))
            shares.append(share)
        self._roots, self._shares = np.array(roots), np.array(shares)
        values = self._informed.max(axis=0)
        low, high = float(blind.min()), float(values.max())
        self.rounding = _ROUNDING * float(np.abs(self._informed).max())
        self._scale = np.array([low, max(high - low, 1e-12), max(np.log(len(belief)), 1.0), _BINS])

    def _link(self, vector: int, parts: npt.NDArray[np.intp]) -> None:
        graph = self._graph
        begin = graph.counts[LINKS]
        graph.link[begin : begin + len(parts)] = parts
        graph.num_links[vector] = len(parts)
        graph.counts[LINKS] += len(parts)

    def _part(self, vector: int) -> Vector:
        block = self._graph.vector_block[vector]
        width = self._layout.first_state[block + 1] - self._layout.first_state[block]
        at = self._graph.first_value[vector]
        return self._graph.values[at : at + width]

    def compile(self, limits: Limits) -> None:
        """Go on with compiled steps where the work turns out to be long."""
        if self._is_plain and limits.seconds > _SHORT:
            self._is_plain = False
            with limits.uncounted():
                self._steps = _fastest()

    def _grow(self, limits: Limits | None = None) -> bool:
        """Make room for another step, if the limits allow it."""
        lengths = lacking(self._graph, self._needed)
        if lengths and limits is not None and not limits.allows(bytes_of(self._graph, lengths)):
            return False
        for name, length in lengths.items():  # one by one: a full array is gone before the next is copied
            self._graph = grown(self._graph, {name: length})
        return True

    def _leaves_room(self, limits: Limits) -> bool:
        """Whether there is room for a policy once beliefs are forgotten; else the run ends."""
        edges, outcomes, weights, values = self._graph.counts[[EDGES, OUTCOMES, WEIGHTS, VALUES]].tolist()
        # One of all vectors sorts them, and lays them out by states; a small one is chosen among the active.
        needed = 2 * 8 * values
        if not self._whole:
            active = self.size * int(self._layout.first_state[1])
            needed = max(needed, 8 * active * (1 + max(CHOICE, _SMALLER * EVALUATION)))
        return limits.allows(int(needed) - (28 * edges + 16 * outcomes + 12 * weights))

    @property
    def size(self) -> int:
        """The number of active vectors."""
        return int(self._graph.is_active[: self._graph.counts[VECTORS]].sum())

    def bounds(self) -> tuple[float, float]:
        """Return the bounds at the initial belief."""
        for root in self._roots:
            self._steps.refresh(self._graph, self._scratch, root)
        return (
            float(self._shares @ self._graph.lower[self._roots]),
            float(self._shares @ self._graph.upper[self._roots]),
        )

    def run(self, limits: Limits, end: float = np.inf) -> None:
        """Run some trials, for about a twentieth of a second, none of them deeper than there is time for.

        Args:
            limits: Those of the run.
            end: The seconds of the run at which trials are to end.
        """
        self._prune(limits)
        if not (self._grow(limits) and self._leaves_room(limits)):
            return
        began = limits.seconds
        depth = _DEPTH if end == np.inf else int(np.clip((end - began) / self._pace, _LEAST_DEPTH, _DEPTH))
        with np.errstate(all="ignore"):  # compiled steps tell nothing either of what overflows
            done = self._steps.explore(
                self._layout,
                self._graph,
                self._scratch._replace(path=self._scratch.path[:depth]),
                self._informed,
                self._roots,
                self._shares,
                self._room,
                self._scale,
                limits.gap,
                self._budget,
            )
        steps = done if done >= 0 else -1 - done
        self.backups += steps
        took = max(limits.seconds - began, 1e-4)
        self._pace = took / max(steps, 1)
        if done >= 0:
            share = 0.05 / took
            self._budget = int(min(max(16, self._budget * min(share, 4.0)), 1e6))

    def _prune(self, limits: Limits) -> None:
        """Prune each part that has grown by half since its last pruning, where there is room to do so."""
        counts = self._graph.counts
        many = counts[NODES] > 2 * self._kept_nodes + _LEAST_NODES
        if many and bytes_to_forget_nodes(self._graph) < limits.room:
            self._roots = forget_nodes(self._graph, self._roots)
            self._kept_nodes = int(counts[NODES])
        if self.size > 1.5 * self._kept_vectors + _LEAST_VECTORS:
            self.prune(limits)
        if counts[POINTS] > 1.5 * self._kept_points + _LEAST_VECTORS:
            prune_points(self._graph)
            self._kept_points = int(counts[POINTS])

    def prune(self, limits: Limits) -> None:
        """Remove the vectors that no visited belief needs, where there is room to do so."""
        if bytes_to_need_vectors(self._graph) >= limits.room:
            return
        lower, upper = self.bounds()
        slack = min(1e-2 * limits.gap, 1e-5 * (upper - lower))
        prune_vectors(self._graph, self._layout, needed_vectors(self._graph, self._layout, self._roots, slack))
        self._kept_vectors = self.size

    def learn_followers(self, limits: Limits) -> None:
        """Learn the follower of each vector after each observation at the first belief that it is the best at.

        Where there is no room for that, it is not known.
        """
        graph, self._after = self._graph, None
        count = int(graph.counts[NODES])
        symbols = int(self._layout.observations.columns.max()) + 1
        if 64 * count + 8 * int(graph.counts[VECTORS]) * symbols >= limits.room:
            return
        nodes = np.flatnonzero((graph.first_edge[:count] >= 0) & (graph.best[:count] >= 0))
        vectors, first = np.unique(graph.best[nodes], return_index=True)
        edges = graph.first_edge[nodes[first]] + graph.vector_action[vectors]
        after = np.full((int(graph.counts[VECTORS]), symbols), -1)
        for vector, edge in zip(vectors.tolist(), edges.tolist(), strict=True):
            outcomes = slice(graph.first_outcome[edge], graph.first_outcome[edge] + max(graph.num_outcomes[edge], 0))
            after[vector, graph.symbol[outcomes]] = graph.best[graph.child[outcomes]]
        self._after = after

    def forget_beliefs(self) -> None:
        """Let go of all that only the search for more vectors needs: there are no bounds and no trials after that."""
        self._graph = without_beliefs(self._graph)

    def whole(self) -> Vectors:
        """Return the best vectors at the roots, and all that they are made of.

        So each vector is at most the value of an action followed by others of them, and a policy of them earns no less
        than the lower bound.
        """
        prune_vectors(self._graph, self._layout, self._is_part())
        # The graph's own: there may be no room for a copy.
        return self._vectors(slice(0, int(self._graph.counts[VECTORS])))

    def _is_part(self) -> npt.NDArray[np.bool_]:
        """Return a mask of the best vectors at the roots and all that they are made of."""
        graph = self._graph
        needed = np.zeros(int(graph.counts[VECTORS]), dtype=np.bool_)
        needed[graph.best[self._roots]] = True
        needed[graph.default_vector] = True
        return parts_of(graph, needed)

    def condense(self, limits: Limits) -> None:
        """Add the vectors of a good plan, with the values that they have there, for a part of the time."""
        began = limits.seconds
        if began < self._next_plan:
            return
        lower, upper = self.bounds()
        tried, known = divmod(self._tries, 2)
        slack = _FEWER[tried % len(_FEWER)] * (upper - lower)
        if known:
            self.learn_followers(limits)
        end = min(began + 2 * max(_LEAST_PLAN, _PLANS * began), max(limits.end / (1 + _RESERVED), began + _LEAST_PLAN))
        found = self._plan(limits, slack, end, known=bool(known))
        gains = found is not None and found.lower > lower + _GAIN * (upper - lower)
        if found is not None and gains:
            self._add(found)
            self.prune(limits)
        else:
            self._tries += 1
        share = _PLANS if gains else _PLANS / 2
        self._next_plan = limits.seconds + (limits.seconds - began) / share

    def _add(self, plan: Condensed) -> None:
        first = int(self._graph.counts[VECTORS])
        for values, action, block, followers in zip(*plan.vectors, plan.followers, strict=True):
            self._grow()
            vector = self._steps.add_vector(self._layout, self._graph, int(block), int(action))
            self._link(vector, first + followers)
            self._part(vector)[:] = values

    def condensed(self, limits: Limits, lower: float, upper: float) -> tuple[Vectors, float] | None:
        """Return few vectors and their lower bound; None where they would not keep the bound that was found."""
        least, part = _CONDENSATION
        end = min(limits.seconds + max(least, part * limits.seconds), limits.end + _BEYOND)
        enough = min(lower, upper - limits.gap) if limits.reason == "gap" else lower - self.rounding
        for share, known in product(_FEWER, (False, True)):
            now = limits.seconds
            if now >= end:
                break
            until = end if known else now + _FROM_ALL * (end - now)
            found = self._plan(limits, share * max(upper - lower, 0.0), until, known=known)
            if found is not None and found.lower >= enough:
                return found.vectors, found.lower
        return None

    def _plan(self, limits: Limits, slack: float, end: float, *, known: bool) -> Condensed | None:
        """Return a plan; one that begins with the known followers of each vector, or one of all vectors."""
        graph = self._graph
        chosen = graph.is_active[: graph.counts[VECTORS]] > 0
        chosen[graph.default_vector] = True
        if slack == 0:  # only with the parts of the best vectors is there a plan that loses nothing
            chosen |= self._is_part()
        some = np.flatnonzero(chosen)
        numbers = len(some) * int(self._layout.first_state[1])
        if 8 * numbers * (1 + CHOICE) >= limits.room:
            return None
        vectors = self._vectors(some)
        start = self._model.initial_belief[self._order].reshape(-1, vectors.values.shape[1])
        after = None
        if known and self._after is not None:
            place = np.full(len(chosen) + 1, -1)  # what is not chosen among, and no vector, is the default
            place[some] = np.arange(len(some))
            after = place[self._after[some]]
        steps, compiled = self._steps, not self._is_plain and can_compile()
        return condensed(
            self._layout,
            vectors,
            np.searchsorted(some, graph.default_vector),
            start,
            np.searchsorted(some, graph.best[self._roots]),
            slack=slack,
            after=after,
            kernels=Kernels(steps.follow, steps.arrive, self._scratch) if compiled else None,
            fits=lambda size: size < limits.room,
            part=lambda share: limits.until(limits.seconds + share * (end - limits.seconds)),
        )

    def _vectors(self, which: npt.NDArray[np.intp] | slice) -> Vectors:
        graph = self._graph
        values = rows_of(graph, int(self._layout.first_state[1]))[which]
        return Vectors(values, graph.vector_action[which].astype(np.intp), graph.vector_block[which].astype(np.intp))

    def policy(self, vectors: Vectors) -> AlphaVectors | MixedAlphaVectors:
        """Return vectors as a policy."""
        values, actions = vectors.values, vectors.actions.tolist()
        num_actions = len(self._model.action_space)
        if self._model.observed:
            return MixedAlphaVectors(values, actions, vectors.blocks.tolist(), num_actions, states=self._model.layout)
        return AlphaVectors(values, actions, num_actions)
