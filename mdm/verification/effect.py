"""The effect of a shield: how probable X and the goal are without and with it, and the return that it costs."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.errors import ConfigError, ModelError
from mdm.loading import model_of
from mdm.solvers.evaluation import exact_values
from mdm.verification.verification import Estimate, Exact, verify

if TYPE_CHECKING:
    from collections.abc import Callable

    from mdm.loading import GivenModel


class Effect(msgspec.Struct, frozen=True):
    """The numbers of a policy without and with its shield.

    Attributes:
        avoid: The probability that X is ever reached, before and after.
        keep: That of the specification that is kept; None if none is.
        value: The expected discounted return; None where it has no bound, or the time has passed.
        value_error: Half the width of the 95 % interval of each of them; 0 where they are exact.
    """

    avoid: tuple[Exact | Estimate, Exact | Estimate]
    keep: tuple[Exact | Estimate, Exact | Estimate] | None
    value: tuple[float, float] | None
    value_error: float

    @property
    def lost(self) -> float | None:
        """The return that the shield costs."""
        return None if self.value is None else self.value[0] - self.value[1]


def effect(shielded: Any, model: GivenModel, *, seconds: float = 10.0, seed: int = 0) -> Effect:
    """Return the effect of a shield.

    Args:
        shielded: A policy that `mdm.shield` has made.
        model: Its model, or the path of its file.
        seconds: The time for simulations, where numbers are not exact; each has a sixth of it, but an episode at least.
        seed: Of the simulations.

    Raises:
        ConfigError: If the policy is not shielded.
        ModelError: If a number is not known, see `mdm.verify`.

    Example::

        safe = mdm.shield("grid.policy", "grid.mdp", avoid="pit-*", keep="reach goal")
        before, after = mdm.verification.effect(safe, "grid.mdp").avoid
        before.value, after.value  # 1.0, 0.0
    """
    from mdm.simulation import evaluate  # noqa: PLC0415 - loads what runs episodes

    model = model_of(model)
    if not hasattr(shielded, "wanted"):
        raise ConfigError(f"the effect is that of a shield, and a {type(shielded).__name__} has none", key="shielded")

    def limit() -> Callable[[int, int], bool]:
        until = time.monotonic() + seconds / 6
        return lambda ended, _: ended > 0 and time.monotonic() > until

    both, values, error = (shielded.policy, shielded), list[float](), 0.0

    def asked(text: str) -> Any:
        return tuple(verify(model, text, each, seed=seed, progress=limit()).result for each in both)

    for each in both:
        try:
            exact = exact_values(model, each)
            if exact is not None:
                values.append(float(model.initial_belief @ exact))
                continue
            found = evaluate(model, each, seed=seed, progress=limit())
        except (ConfigError, ModelError):  # it has no bound
            continue
        values.append(found.mean)
        error = max(error, (found.interval[1] - found.interval[0]) / 2)
    known = len(values) == 2 and bool(np.isfinite(values).all())
    kept = None if shielded.keep is None else asked(f"P({shielded.keep})")
    return Effect(asked(f"P(reach {shielded.avoid})"), kept, (values[0], values[1]) if known else None, error)
