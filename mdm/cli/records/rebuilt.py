"""The actors of a recorded run, built anew from what its record keeps, and not started."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mdm.cli.policies.simulate import recorded_simulation
from mdm.config.recorded import load_recorded
from mdm.replay import transports_of

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.actors import Ensemble
    from mdm.config import System
    from mdm.recording import Record
    from mdm.replay.transport import ReplayTransport

__all__ = ["Rebuilt", "rebuilt"]


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
