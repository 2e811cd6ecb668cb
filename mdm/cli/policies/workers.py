"""Workers of a command: processes here, or those of a Dask scheduler, and their facts."""

from __future__ import annotations

import importlib
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.cli.usage import UsageError
from mdm.errors import Error
from mdm.simulation.processes import Processes

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from concurrent.futures import Executor

    from mdm.simulation import Evaluation


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
        with Processes(None if arguments.workers == "auto" else arguments.workers) as processes:
            yield processes
    else:
        yield None


def _client(where: str) -> Any:
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise Error("--dask needs Dask: pip install distributed") from None
    given = {"scheduler_file" if Path(where).exists() else "address": where}
    try:
        client = distributed.Client(**given, timeout=5, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise Error(f"there is no Dask scheduler at {where} ({why}): start one by dask scheduler") from None
    if not client.nthreads():
        client.close()
        raise Error(f"the Dask scheduler at {where} has no workers: start some by dask worker {where}")
    return client


def of_run(result: Evaluation) -> dict[str, Any]:
    """Return the facts that differ from run to run, ready for JSON."""
    workers = msgspec.to_builtins(result.workers)
    return {"seconds": result.seconds, "steps_a_second": result.steps_a_second, "workers": workers}
