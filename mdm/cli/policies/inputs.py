"""What several sub-commands take: a model, a policy for it, and the workers of a simulation."""

from __future__ import annotations

import importlib
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.cli.usage import UsageError
from mdm.errors import Error, FormatError, ModelError
from mdm.formats import load_durations, load_model
from mdm.loading import pair_of

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from concurrent.futures import Executor

    from mdm.models import MDP, Durations
    from mdm.models.units import Unit
    from mdm.simulation import Evaluation

_ALIKE = 1e-9
"""Discounts that differ by less count as the same."""


def load(path: str, discount: float | None, of: Unit | None = None) -> MDP:
    """Load a model, with another discount, or of another unit, if one is given."""
    model = load_model(path)
    return model.with_discount(model.discount if discount is None else discount, of=of)


def load_durations_for(model: MDP, path: str | None) -> Durations | None:
    """Load durations, if a file is given, and check that they are for a model of these sizes."""
    if path is None:
        return None
    durations = load_durations(path)
    try:
        durations.table(model)
    except ModelError as error:
        raise FormatError(str(error), file=path) from None
    return durations


def visibility(model: MDP, policy: Any = None) -> str | None:
    """Return a sentence that names the state factors that are seen, as the model or the policy has it; else None."""
    factors = model.state_space.factors
    if policy is not None and policy.input == "state" and model.pomdp is not None:
        names = [factor.name for place, factor in enumerate(factors) if place not in model.observed]
        if names:
            return f"the policy is over states: it takes {', '.join(names)} as seen at each step, which the model hides"
    if not model.observed:
        return None
    names = [factors[place].name for place in model.observed]
    return f"the agent sees {', '.join(names)} at the start and at every step, as the model declares"


def hidden_times(model: MDP, durations: Durations | None) -> str | None:
    """Return a sentence about durations that differ among states which the agent cannot tell apart; None if none do."""
    if durations is None or model.pomdp is None:
        return None
    discounts = durations.discounts(model)
    groups = model.pomdp.seen_in
    if all(np.ptp(discounts[groups == group], axis=0).max() < _ALIKE for group in np.unique(groups)):
        return None
    return (
        "how long actions take differs among states that the agent cannot tell apart: a policy that chooses by plain "
        "beliefs may earn less than the lower bound; mdm evaluate --durations tells how much it is"
    )


def load_for(model: MDP, path: str, arguments: argparse.Namespace) -> tuple[Any, MDP]:
    """Load a policy; return it with the model as the policy sees it, including the given false negative.

    A controller made for the model's own observations gets only these, without the fully observed factors.
    """
    return pair_of(model, path, seed=arguments.seed, false_negative=arguments.false_negative)


def with_false_negatives(model: MDP, arguments: argparse.Namespace) -> MDP:
    """Return a model with the command's false negative, if one was given."""
    symbol = arguments.false_negative
    return model if symbol is None else model.with_false_negatives(symbol)


@contextmanager
def executor_of(arguments: argparse.Namespace) -> Iterator[Executor | None]:
    """Yield who runs the parts of a command; None for this process.

    Raises:
        Error: If Dask is not installed, or there is no scheduler or no worker.
    """
    if arguments.dask is not None:
        if arguments.workers:
            raise UsageError("--workers are processes here, and --dask has workers of its own: give either")
        with _client(arguments.dask) as client:
            yield client.get_executor(pure=False)
    elif arguments.workers:
        from mdm.simulation import Processes  # noqa: PLC0415 - slow to import

        with Processes(None if arguments.workers == "auto" else arguments.workers) as processes:
            yield processes
    else:
        yield None


def _client(where: str) -> Any:
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise Error("--dask needs Dask, the extra mdm[dask]: pip install distributed") from None
    address = where
    try:
        if Path(where).is_file():
            address = str(msgspec.json.decode(Path(where).read_bytes(), type=dict[str, Any]).get("address"))
        if not address.rpartition(":")[2].isdecimal():  # or the client would not end
            raise Error(f"{where} is neither the address of a Dask scheduler, as tcp://scheduler:8786, nor its file")
        client = distributed.Client(address, timeout=5, set_as_default=False)
    except (OSError, ValueError, TypeError, msgspec.DecodeError) as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise Error(f"there is no Dask scheduler at {where} ({why}): start one by dask scheduler") from None
    if not client.nthreads():
        client.close()
        raise Error(f"the Dask scheduler at {where} has no workers: start some by dask worker {address}")
    return client


def of_run(result: Evaluation) -> dict[str, Any]:
    """Return the facts that differ from run to run, ready for JSON."""
    workers = msgspec.to_builtins(result.workers)
    return {"seconds": result.seconds, "steps_a_second": result.steps_a_second, "workers": workers}
