"""A POMDP's dynamics as CSR matrices, for the belief filters of large models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.models.compressed import csr, is_compressed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.models.detection import Resolvent
    from mdm.models.matrices import Matrix
    from mdm.models.pomdp import POMDP

__all__ = ["Rows", "once"]


class Rows:
    """The matrices by which a belief moves: T and P(o | a, s'), or P(s', o | s, a) where these are not enough.

    Args:
        model: The POMDP.
    """

    def __init__(self, model: POMDP) -> None:
        self.num_states = len(model.state_space)
        self.num_observations = len(model.observation_space)
        self.initial = model.initial_belief
        actions, observations = range(len(model.action_space)), range(self.num_observations)
        self.false_negative = model.false_negative
        self.resolvents: list[Resolvent] = []
        """By which a belief moves along the false negatives of each action, where the model has any."""
        if model.false_negative is not None:
            self.resolvents = [model.resolvent(a) for a in actions]
        self.transitions = once([model.transition_matrix(a) for a in actions], _compressed)
        """T of each action, S x S'."""
        self.joints: list[list[Matrix]] | None = None
        """P(s', o | s, a) of each action and observation, S x S', of events and with false negatives."""
        self.observations: list[Matrix] = []
        """P(o | a, s') of each action, S' x O, where there are no joints."""
        if model.event_observations or model.false_negative is not None:
            self.joints = [[csr(model.joint_matrix(a, o), copy=False) for o in observations] for a in actions]
        else:
            self.observations = once([model.observation_matrix(a) for a in actions], _compressed)

    @property
    def entries(self) -> int:
        """How many numbers the matrices hold by which a belief moves, the starts of their rows included."""
        moved = self.transitions if self.joints is None else [each for joints in self.joints for each in joints]
        return sum(matrix.nnz + matrix.shape[0] for matrix in {id(matrix): matrix for matrix in moved}.values())


def once(matrices: Sequence[Matrix], make: Callable[[Matrix], Any]) -> list[Any]:
    """Return what is made of each matrix; made once of a matrix that several actions share."""
    done: dict[int, Any] = {}
    for matrix in matrices:
        if id(matrix) not in done:
            done[id(matrix)] = make(matrix)
    return [done[id(matrix)] for matrix in matrices]


def _compressed(matrix: Matrix) -> Matrix:
    return matrix if is_compressed(matrix) else csr(matrix)
