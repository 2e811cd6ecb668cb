"""Loss: how much less a policy is worth than it seems, if a row of the model is as estimated.

The value of a policy solves the linear equations V = R + discount * T V (M. L. Puterman, *Markov Decision Processes*,
1994, section 6.1). With another row in T the matrix differs by a product of two vectors, so that the new value follows
from one factorisation for all rows (Sherman and Morrison): O(S^2) a row.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.estimation.reestimation import expected_reward
from mdm.models.dynamics import Dynamics
from mdm.models.matrices import is_compressed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt

    from mdm.estimation.chains import Chain, Kind
    from mdm.estimation.rows import Row
    from mdm.models.matrices import Vector
    from mdm.models.mdp import MDP

_ROUNDS = 1_000


class Values:
    """The value of a policy in its model, and in models that differ by a row.

    Args:
        model: The model; its discount is less than 1.
        policy: The action of each state, S numbers.

    Raises:
        ModelError: If the discount is 1: the equations have no unique solution.
    """

    def __init__(self, model: MDP, policy: Sequence[int] | npt.NDArray[np.intp]) -> None:
        if model.discount >= 1:
            raise ModelError("the value of a policy is a solution of equations where the discount is less than 1")
        self.policy = np.asarray(policy, dtype=np.intp)
        """The action of each state."""
        self._discount = model.discount
        self._start = model.initial_belief
        matrix, rewards = Dynamics(model).under(self.policy)
        size = len(rewards)
        if is_compressed(matrix):
            from scipy.sparse import eye_array  # noqa: PLC0415 - slow to import
            from scipy.sparse.linalg import splu  # noqa: PLC0415 - slow to import

            self._solve = splu((eye_array(size, format="csr") - model.discount * matrix).tocsc()).solve
        else:
            inverse = np.linalg.inv(np.eye(size) - model.discount * matrix)
            self._solve = inverse.__matmul__
        self._matrix = matrix
        self.values: Vector = np.asarray(self._solve(rewards))
        """The value of each state: S numbers."""

    @property
    def start(self) -> float:
        """The value at the beginning."""
        return float(self._start @ self.values)

    def with_row(self, state: int, symbols: npt.NDArray[np.intp], row: Vector, *, earned: float = 0.0) -> float:
        """Return the value at the beginning of the model in which other probabilities follow a state.

        Args:
            state: The state.
            symbols: The states that follow it.
            row: Their probabilities.
            earned: By how much the reward in the state is more.
        """
        change = np.zeros(len(self.values))
        change[symbols] = row
        old = self._matrix[[state]]
        change -= np.asarray(old.toarray() if is_compressed(old) else old).ravel()
        unit = np.zeros(len(self.values))
        unit[state] = 1
        reached = np.asarray(self._solve(unit))
        grown = earned + self._discount * float(change @ self.values)
        grown /= 1 - self._discount * float(change @ reached)
        return float(self._start @ (self.values + grown * reached))


def losses(model: MDP, values: Values, rows: Iterable[Row], kind: Kind) -> list[float | None]:
    """Return by how much the value at the beginning falls if each row alone is as estimated.

    It is None for actions that the policy does not take, and negative where the policy is worth more than it seems.

    Args:
        model: The model.
        values: The value of the policy in it.
        rows: The rows.
        kind: Of ``jumps`` the rows leave out staying, whose probability is the model's.
    """
    result: list[float | None] = []
    flat = model.flatten()
    for row in rows:
        if int(values.policy[row.state]) != row.action or not len(row.symbols):
            result.append(None)
            continue
        stays = float(flat.transition_matrix(row.action)[row.state, row.state]) if kind == "jumps" else 0.0
        symbols, estimates = row.symbols, row.estimates
        if stays:
            symbols, estimates = np.append(symbols, row.state), np.append(estimates * (1 - stays), stays)
        earned = 0.0
        if flat.outcome_rewards is not None:
            earned = expected_reward(flat, row.action, row.state, symbols, estimates)
            earned -= float(flat.rewards[row.state, row.action])
        result.append(values.start - values.with_row(row.state, symbols, estimates, earned=earned))
    return result


def decided_policy(model: MDP, chains: Iterable[Chain]) -> npt.NDArray[np.intp]:
    """Return the action that was decided most often in each state; elsewhere the best one, given these.

    The best are found by policy iteration.

    Raises:
        ModelError: If the discount is 1.
    """
    counts = np.zeros(model.rewards.shape, dtype=np.int64)
    for chain in chains:
        for decision in chain.decisions:
            if decision.state is not None:
                counts[decision.state, decision.action] += 1
    seen = counts.any(axis=1)
    policy: npt.NDArray[np.intp] = np.where(seen, counts.argmax(axis=1), model.rewards.argmax(axis=1))
    dynamics = Dynamics(model)
    for _ in range(_ROUNDS):
        table = dynamics.q_values(Values(model, policy).values)
        gains = table.max(axis=1) - table[np.arange(len(table)), policy]
        better = ~seen & (gains > 1e-9)
        if not better.any():
            break
        policy = np.where(better, table.argmax(axis=1), policy)
    return policy
