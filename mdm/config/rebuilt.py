"""The actors of a recorded run, built anew from what its record keeps, and not started."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mdm.config.recorded import check_digests, check_team, load_recorded
from mdm.config.simulations import recorded_simulation
from mdm.config.system import System
from mdm.replay import transports_of
from mdm.replay.replay import check_beginning

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.actors import Ensemble
    from mdm.recording import Record
    from mdm.replay.transport import ReplayTransport

__all__ = ["Rebuilt", "rebuilt", "rebuilt_to_compare"]


class Rebuilt(NamedTuple):
    """The actors of a recorded run.

    Attributes:
        actors: The system, or the ensemble of a simulation.
        ensembles: The ensembles by their paths.
        transports: Of agents of a team, what carries their messages in a replay.
    """

    actors: System | Ensemble
    ensembles: dict[str, Ensemble]
    transports: dict[str, ReplayTransport]


def rebuilt(record: Record, folder: str | Path, given: str | Path | None = None) -> Rebuilt:
    """Return the actors of a recorded run.

    Args:
        record: The record.
        folder: Where its files are laid out.
        given: A TOML file, in place of what the record keeps.

    Raises:
        ConfigError: If the record has no configuration and none is given, or that cannot be loaded.
    """
    transports = transports_of(record) if "stimuli" in record.topics else {}
    if "simulation" in record.head:
        simulated = recorded_simulation(record, folder, given)
        return Rebuilt(simulated, {simulated.path: simulated}, transports)
    system = load_recorded(record, folder, given, transport=next(iter(transports.values()), None))
    return Rebuilt(system, {ensemble.path: ensemble for ensemble in system.ensembles.values()}, transports)


def rebuilt_to_compare(record: Record, folder: str | Path, given: str | Path | None = None) -> Rebuilt:
    """Return the actors of a recorded run whose decisions can be compared with those of the record.

    Args:
        record: The record.
        folder: Where its files are laid out.
        given: A TOML file, in place of what the record keeps.

    Raises:
        ConfigError: If the record has no configuration and none is given, or that cannot be loaded.
        Error: If the record has no beginning, its model, policy or options are others than in the run, or an agent's
            team would refuse it.
    """
    check_beginning(record)  # first: of one that was torn early, its files may be missing as well
    run = rebuilt(record, folder, given)
    if given is None:
        check_digests(record, run.ensembles.values())
    if isinstance(run.actors, System):
        check_team(record, run.actors)
    return run
