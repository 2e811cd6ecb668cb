"""The resolvents of solvers: the rewards and steps of an action before the next detection.

With S(s, s') the probability of a step without a detection, and g the discount, an action with reward r in a step has
reward (I - g S)^-1 r up to the detection, whose probabilities are multiplied by the same matrix
(J. V. Messias, M. T. J. Spaan and P. U. Lima, *Asynchronous execution in multiagent POMDPs: reasoning over
partially-observable events*, MSDM 2013).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.models.detection import Resolvent, is_rounding

if TYPE_CHECKING:
    from mdm.models.matrices import Matrix

__all__ = ["discounted_resolvent"]

_ENDLESS = 1e9


def discounted_resolvent(steps: Matrix | None, discount: float, name: str) -> Resolvent | None:
    """Return the resolvent of an action's steps without a detection; None where every event is detected.

    Args:
        steps: The probabilities of these steps, S x S', dense or CSR; None where there are none.
        discount: What a step is discounted by.
        name: The action's.

    Raises:
        ModelError: If the discount is 1 and nothing may ever be detected.
    """
    if steps is None or is_rounding(steps):
        return None
    endless = f"the discount is 1, and action {name!r} may go on for ever without anything being detected"
    try:
        resolvent = Resolvent(discount * steps)
    except (np.linalg.LinAlgError, RuntimeError):
        raise ModelError(endless) from None
    if not np.abs(resolvent.values(np.ones(steps.shape[0]))).max() < _ENDLESS / max(1 - discount, 1e-6):
        raise ModelError(endless)
    return resolvent
