"""Solving by name: the list of solvers, the default one for a model, and models where not all actions are available.

Values of an MDP are right where not all actions are available, for the first available action stands in. In a POMDP an
action would still count for its information where it is not available: it is made so dear there that any available
policy earns more. The agent knows which actions are available (`mdm.models.availability.check_known`), so that bounds
at beliefs that occur stay those of available actions. Alpha vectors are kept for the states where their action is
available. Beside them stand those of a policy that takes the first available action: where the best vector's action is
not available, these are above it.
"""

from __future__ import annotations

import copy
import importlib
import inspect
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.checks import check_flag, check_seed, is_whole
from mdm.errors import ConfigError
from mdm.loading import model_of
from mdm.models import in_time
from mdm.models.availability import first_available
from mdm.models.units import check_steps
from mdm.policies import AlphaVectors, DeterministicPolicy, MaskedAlphaVectors, QTable, StagedPolicy
from mdm.solvers.evaluation import state_values
from mdm.solvers.solution import Limits

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mdm.loading import GivenModel
    from mdm.models import MDP, Durations
    from mdm.solvers.solution import Progress, Solution

SOLVERS: dict[str, tuple[str, str, str]] = {
    "value-iteration": ("mdp.value_iteration", "value_iteration", "MDP"),
    "prioritised-sweeping": ("mdp.value_iteration", "prioritised_sweeping", "MDP"),
    "policy-iteration": ("mdp.policy_iteration", "policy_iteration", "MDP"),
    "modified-policy-iteration": ("mdp.value_iteration", "modified_policy_iteration", "MDP"),
    "qmdp": ("bounds", "qmdp", "POMDP"),
    "fib": ("bounds", "fast_informed_bound", "POMDP"),
    "perseus": ("perseus", "perseus", "POMDP"),
    "sarsop": ("sarsop", "sarsop", "POMDP"),
    "jesp": ("jesp", "jesp", "POMDP"),
}
"""For each name the module, its function, and the kind of model that it solves."""


def default_solver(model: MDP, options: Iterable[str] = ()) -> str:
    """Return the default solver for a model, one that takes the given options if there is any."""
    first, other = "modified-policy-iteration", "value-iteration"
    if model.pomdp is not None:
        first, other = "sarsop", "perseus"
    given = set(options)
    return other if not given <= set(options_of(first)) and given <= set(options_of(other)) else first


def options_of(solver: str) -> list[str]:
    """Return the names of the options that a solver takes beside its limits."""
    _, *parameters = inspect.signature(_function(solver)).parameters
    return [name for name in parameters if name != "limits"]


def policy_class(solver: str, model: MDP, *, horizon: int | None, durations: Durations | None) -> type:
    """Return the class of the policies that a solver makes of a model, before it makes one.

    Args:
        solver: One of `SOLVERS`.
        model: The model.
        horizon: That of the plan, if it has one.
        durations: How long actions take; the solved model is then that in time (`mdm.models.in_time`).
    """
    kinds: tuple[type, type, type] = vars(_function(solver))["policies"]
    policy, to_horizon, mixed = kinds
    if model.available is not None and policy is AlphaVectors:
        return MaskedAlphaVectors
    if horizon is not None:
        return to_horizon
    return mixed if model.observed and durations is None else policy


def solve(
    model: GivenModel,
    solver: str | None = None,
    *,
    durations: Durations | None = None,
    gap: float = 1e-3,
    time: float | None = None,
    iterations: int | None = None,
    memory: int | None = None,
    progress: Callable[[Progress], object] | None = None,
    **options: Any,
) -> Solution:
    """Solve a model: return a policy, with the bounds that certify it.

    It stops at the first of its limits, or at Ctrl-C, and returns the best policy that it has by then.

        solution = mdm.solve("tiger.pomdp", gap=0.01, time=60)
        print(solution.lower, solution.upper, solution.reason)
        mdm.save_policy(solution.policy, "tiger.npz")

    Args:
        model: The model, or the path of its file.
        solver: One of `SOLVERS`; by default one that suits the model and the options.
        durations: How long actions take, and how much they earn by time; the next is decided when an action is over.
            By default all take one time step. Where a hidden state makes actions longer, the bounds are of beliefs that
            discount long actions: those of `mdm.models.in_time`.
        gap: Stop when the bounds at the initial belief are no further apart.
        time: Stop after so many seconds.
        iterations: Stop after so many sweeps, trials or rounds.
        memory: Stop when the process holds so many bytes; by default 80 % of the machine's memory.
        progress: Called with each `Progress` that the solver reports; where it returns True, the solver ends with what
            it has.
        options: Options of this solver alone, such as ``horizon``.

    Raises:
        ConfigError: If there is no such solver or option, it is not for such models, or a limit is no number.
        FormatError: If the file holds no model.
        ModelError: If the model has no solution, such as one with a discount of 1 that never ends; or if it is not
            known how much an action's time is discounted (`MDP.with_discount`).
    """
    model = model_of(model)
    name = default_solver(model, options) if solver is None else solver
    if name not in SOLVERS:
        raise ConfigError(f"there is no solver {name!r}; there are {', '.join(SOLVERS)}", key="solver")
    kind = SOLVERS[name][2]
    if kind != model.kind:
        others = ", ".join(other for other, (*_, of) in SOLVERS.items() if of == model.kind)
        raise ConfigError(f"{name} solves {kind}s, not {model.kind}s: take {others}", key="solver")
    _check_options(name, options)
    limits = Limits(gap=gap, time=time, iterations=iterations, memory=memory, progress=progress)
    if durations is None:
        check_steps(model)
    solved = dear(model if durations is None else in_time(model, durations), name, options)
    solution = _function(name)(solved, limits=limits, **options)
    policy: Any = solution.policy if durations is None else solution.policy.for_first_states(len(model.state_space))
    policy = limited(policy, model, durations)
    policy.discount_of, policy.state_space = model.discount_of, model.state_space
    return msgspec.structs.replace(solution, policy=policy)


def _check_options(solver: str, options: dict[str, Any]) -> None:
    """Refuse options that a solver does not take, and values that are none of theirs."""
    known = options_of(solver)
    parameters = inspect.signature(_function(solver)).parameters
    for option, given in options.items():
        if option not in known:
            which = f"its options are {', '.join(known)}" if known else "it has no options but the limits"
            raise ConfigError(f"{solver} takes no {option!r}: {which}", key=option)
        kind, *others = str(parameters[option].annotation).split(" | ")
        if option == "seed":
            check_seed(given)
        elif kind == "bool":
            check_flag(given, option, key=option)
        elif kind == "int" and not is_whole(given) and (given is not None or "None" not in others):
            raise ConfigError(f"{option} is a whole number, not {given!r}", key=option)


def _function(solver: str) -> Callable[..., Solution]:
    module, function, _ = SOLVERS[solver]
    found: Callable[..., Solution] = getattr(importlib.import_module(f"mdm.solvers.{module}"), function)
    return found


# -- Availability ------------------------------------------------------------------------------------------------------


def dear(model: MDP, solver: str, options: dict[str, Any]) -> MDP:
    """Return a model to be solved, in which unavailable actions are too dear to be chosen; an MDP is itself.

    Raises:
        ConfigError: If the solver cannot tell which actions are available, or the discount of a POMDP is 1.
    """
    if model.available is None or model.pomdp is None:
        return model
    if solver == "jesp" or options.get("horizon") is not None:
        raise ConfigError(
            "plans for the agents of a team, and for a horizon, do not know which actions are available: take sarsop, "
            "or perseus without a horizon",
            key="solver",
        )
    if model.discount == 1:
        raise ConfigError("a POMDP in which some actions are not available needs a discount below 1", key="discount")
    least, most = (float(end) / (1 - model.discount) for end in (model.rewards.min(), model.rewards.max()))
    price = least - model.discount * most - max(most - least, 1.0)
    made = copy.copy(model)
    rewards = np.where(model.available, model.rewards, price)
    rewards.setflags(write=False)
    vars(made).update(_rewards=rewards, outcome_rewards=None, available=None, stacked={})
    return made


def limited(policy: Any, model: MDP, durations: Durations | None) -> Any:
    """Return the policy of a solver that chooses available actions alone."""
    available = model.available
    if available is None:
        return policy
    if isinstance(policy, QTable | StagedPolicy):
        return type(policy)(np.where(available, policy.values, -np.inf))
    assert isinstance(policy, AlphaVectors)
    first = first_available(available)
    values = state_values(model, DeterministicPolicy(first, available.shape[1]), durations=durations)
    vectors = [{int(s): float(values[s]) for s in np.flatnonzero(first == action)} for action in np.unique(first)]
    actions = np.unique(first).tolist()
    for action, vector in zip(policy.actions, policy.vectors, strict=True):
        if (states := np.flatnonzero(available[:, action])).size:
            vectors.append(dict(zip(states.tolist(), vector[states].tolist(), strict=True)))
            actions.append(action)
    return MaskedAlphaVectors(vectors, actions, *available.shape)
