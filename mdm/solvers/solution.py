"""The result of a solver: a policy, the bounds that certify it, and their history."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, TypeVar

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Progress", "Reason", "Solution", "makes"]

_Solver = TypeVar("_Solver", bound="Callable[..., Solution]")

Reason = Literal["gap", "time", "iterations", "memory", "interrupted", "converged", "exact"]


class Progress(msgspec.Struct, frozen=True):
    """How far a solver has come.

    Attributes:
        seconds: Since it began.
        lower: A lower bound of the value of the policy found so far at the initial belief; -inf while nothing is known.
        upper: An upper bound of the value of any policy there; inf while nothing is known.
        iterations: Sweeps, trials or rounds, as the solver counts them.
        size: How large the policy is: vectors, nodes or states.
        memory: Bytes that the process holds.
    """

    seconds: float
    lower: float
    upper: float
    iterations: int
    size: int
    memory: int

    @property
    def gap(self) -> float:
        """How far the bounds are apart."""
        return self.upper - self.lower


class Solution(msgspec.Struct, frozen=True):
    """A policy with its certificate.

    Attributes:
        policy: The policy.
        solver: Which solver made it.
        lower: A lower bound of the policy's value at the initial belief; -inf where the solver proves nothing.
        upper: An upper bound of any policy's value there; inf where the solver proves nothing.
        reason: Why the solver stopped: the ``gap`` asked for was reached, the ``time``, the ``iterations`` or the
            ``memory`` allowed were used up, it was ``interrupted``, it has ``converged`` and would find nothing better,
            or the result is ``exact``.
        history: The progress, in order of time; the last entry is the result.
    """

    policy: Any
    solver: str
    lower: float
    upper: float
    reason: Reason
    history: tuple[Progress, ...]

    def __repr__(self) -> str:
        """Return the certificate, without the history."""
        return (
            f"Solution({self.policy!r}, {self.solver}, value {self.lower:.6g} to {self.upper:.6g}, "
            f"{self.iterations} iterations in {self.seconds:.3g} s, stopped: {self.reason})"
        )

    @property
    def gap(self) -> float:
        """How far the bounds are apart."""
        return self.upper - self.lower

    @property
    def seconds(self) -> float:
        """How long it took."""
        return self.history[-1].seconds

    @property
    def iterations(self) -> int:
        """How many sweeps, trials or rounds it took."""
        return self.history[-1].iterations


def makes(policy: type, *, to_horizon: type | None = None, mixed: type | None = None) -> Callable[[_Solver], _Solver]:
    """Declare the class of a solver's policies.

    Args:
        policy: The class.
        to_horizon: That of plans to a horizon, if it is another.
        mixed: That for models whose observations include factors of the state, if it is another.
    """

    def declare(solver: _Solver) -> _Solver:
        vars(solver)["policies"] = (policy, to_horizon or policy, mixed or policy)
        return solver

    return declare
