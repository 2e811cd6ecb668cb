"""The actors of a recorded run, built anew from what its record keeps, and not started."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from typing import TYPE_CHECKING, NamedTuple

from mdm.config.recorded import check_digests, check_same_team, check_team, load_recorded, team_difference
from mdm.config.simulations import recorded_simulation
from mdm.config.system import System
from mdm.errors import Error
from mdm.replay import replay_together, transports_of
from mdm.replay.replay import check_beginning

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from mdm.actors import Ensemble
    from mdm.recording import Record
    from mdm.replay import Together
    from mdm.replay.transport import ReplayTransport

__all__ = ["Rebuilt", "rebuilt", "rebuilt_to_compare", "replay_team"]


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
    """Return the actors of a recorded run whose decisions can be compared with those of the record: see `rebuilt`.

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
        check_same_team(record, run.actors)
        check_team(record, run.actors)
    return run


def replay_team(records: Mapping[str, Record], given: str | Path | None = None, *, most: int = 100) -> Together:
    """Replay the records of a team's agents together, each with its own configuration, or all with another one.

    Args:
        records: The records, by names of theirs.
        given: A TOML file, in place of what the records keep.
        most: How many differences of each are kept.

    Raises:
        ConfigError: If a record has no configuration, or the one to take cannot be loaded.
        Error: If a record cannot be replayed, or, for another configuration, if the records are not repeated as they
            are with that of their run: then nothing is known of the messages.
    """
    with ExitStack() as folders:

        def folder() -> str:
            return folders.enter_context(tempfile.TemporaryDirectory())

        _check_alike(records)
        if given is None:
            return _replay({name: rebuilt_to_compare(each, folder()) for name, each in records.items()}, records, most)

        def other() -> dict[str, Rebuilt]:
            return {name: rebuilt(record, folder(), given) for name, record in records.items()}

        runs = other()
        _check_same_teams(records, runs)
        teams = [(record, runs[name].actors) for name, record in records.items() if runs[name].transports]
        if all(isinstance(actors, System) and team_difference(record, actors) is None for record, actors in teams):
            result = _replay(runs, records, most)
            if result.same or not teams or not all("configuration" in record.head for record in records.values()):
                return result
            runs = other()  # what nobody compares may differ, too: predicates, or how a state is made of them
        for record in records.values():
            if "configuration" not in record.head:
                raise Error(
                    f"{record.path}: the record has no configuration of its run, by which it would be known what its "
                    f"agent sent: so what another one would have decided cannot be told; mdm run --record keeps it"
                )
        then = {name: rebuilt_to_compare(record, folder()) for name, record in records.items()}
        as_recorded = _replay(then, records, 1)
        if not as_recorded.same:
            name = next(iter(records.values())).path.parent
            raise Error(
                f"{name}: with the configuration of their run the records are not repeated as they are, of which mdm "
                f"replay {name} tells: so what another one would have decided cannot be told"
            )
        return _replay(runs, records, most, as_recorded)


def _check_same_teams(records: Mapping[str, Record], runs: Mapping[str, Rebuilt]) -> None:
    """Refuse a team of another name, or of other agents."""
    for name, run in runs.items():
        if isinstance(run.actors, System):
            check_same_team(records[name], run.actors)


def _check_alike(records: Mapping[str, Record]) -> None:
    """Refuse records of which some are of a team's agents, and some are not: they are not of one run.

    Raises:
        Error: If there are such, or a record has no beginning.
    """
    of_team: dict[bool, Record] = {}
    for record in records.values():
        check_beginning(record)
        of_team.setdefault(bool(transports_of(record)), record)
    if len(of_team) > 1:
        raise Error(
            f"{of_team[True].path} is of an agent of a team, and {of_team[False].path} is not: a folder that is "
            f"replayed together has records of one run alone: move the other one away, and replay it by itself"
        )


def _replay(
    runs: Mapping[str, Rebuilt], records: Mapping[str, Record], most: int, as_recorded: Together | None = None
) -> Together:
    actors = {name: run.actors for name, run in runs.items()}
    transports = {name: run.transports for name, run in runs.items()}
    return replay_together(records, actors, transports, most=most, as_recorded=as_recorded)
