"""Controllers in a control layer: a walk in the place of a belief tracker."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.errors import ModelError
from mdm.models.matrices import distribution
from mdm.policies import Walk

if TYPE_CHECKING:
    import numpy.typing as npt

    from mdm.models import MDP
    from mdm.policies import Controller

__all__ = ["ControllerRun"]


class ControllerRun(Walk):
    """A walk that answers as a `Tracker` does, but knows of no belief.

    Where the values of the nodes are known it begins at the best one for a belief: the one given, or the model's
    initial one.

    Args:
        controller: What is run.
        model: The model, where there is one.
    """

    belief: None = None

    def __init__(self, controller: Controller, model: MDP | None) -> None:
        super().__init__(controller)
        self._num_states = controller.num_states
        self._initial = None if model is None or self._num_states is None else model.initial_belief

    def reset(self, belief: npt.ArrayLike | None = None) -> None:
        """Begin from a belief, or from the initial one.

        Raises:
            ModelError: If the values of nodes are not known, or it is no distribution; the nodes stay as they were.
        """
        if belief is None:
            super().reset(self._initial)
        elif self._num_states is None:
            raise ModelError("the controller goes by observations: its nodes have no known values at a belief")
        else:
            super().reset(distribution(belief, what="the belief", size=self._num_states))

    def update(self, action: int, observation: int | tuple[int | None, ...] | None) -> float:  # noqa: ARG002 - a Tracker's
        """Move by an observation; return 0 where it leads nowhere, else 1."""
        return 1.0 if self.move(observation) else 0.0
