"""The values of several policies in one model, from the same random numbers: differences are known far better."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ConfigError
from mdm.loading import model_of
from mdm.simulation.batch import Evaluation, evaluate

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mdm.loading import GivenModel, GivenPolicy


class Comparison(msgspec.Struct, frozen=True):
    """The results of several policies.

    Attributes:
        evaluations: Of each policy; fewer, and the last of fewer episodes, where it was ended.
    """

    evaluations: tuple[Evaluation, ...]

    def difference(self, place: int) -> tuple[float, float]:
        """Return how much more a policy is worth than the first, and the half of the 95 % confidence interval of that.

        Episodes are paired where none is missing of either.
        """
        theirs, ours = self.evaluations[0], self.evaluations[place]
        if ours.episodes != theirs.episodes or ours.missing or theirs.missing:
            return ours.mean - theirs.mean, 1.96 * math.hypot(ours.standard_error, theirs.standard_error)
        differences = ours.returns - theirs.returns
        error = float(differences.std(ddof=1)) / math.sqrt(len(differences)) if len(differences) > 1 else 0.0
        return float(differences.mean()), 1.96 * error


def compare(
    model: GivenModel,
    policies: Sequence[GivenPolicy],
    *,
    seed: int | None = None,
    progress: Callable[[int, int], object] | None = None,
    **given: Any,
) -> Comparison:
    """Estimate the values of several policies at the start of a model, in episodes with the same random numbers.

    Args:
        model: The model, or the path of its file.
        policies: The policies, of any kind; others are compared with the first.
        seed: The same seed gives the same result; by default it is random.
        progress: Called as by `evaluate`, with the episodes of all policies; where it returns True, the result is of
            the policies, and the episodes of the last, that are known by then.
        given: Other arguments of `evaluate`, such as ``episodes`` and ``executor``.

    Raises:
        ConfigError: If there is no policy, or as of `evaluate`.

    Example::

        result = mdm.compare("tiger.pomdp", ["tiger.vf", "tiger.vf"], episodes=1000, seed=1)
        result.difference(1)  # (0.0, 0.0)
    """
    if not policies:
        raise ConfigError("a comparison needs a policy", key="policies")
    model = model_of(model)
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
    found: list[Evaluation] = []
    stopped = False

    def tell(ended: int, count: int) -> bool:
        nonlocal stopped
        stopped = progress is not None and progress(len(found) * count + ended, len(policies) * count) is True
        return stopped

    for policy in policies:
        found.append(evaluate(model, policy, seed=seed, progress=tell, **given))
        if stopped:
            break
    return Comparison(tuple(found))
