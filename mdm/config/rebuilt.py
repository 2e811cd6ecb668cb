"""The actors of a recorded run, built again from its record, and not started; and how they differ from the run."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from mdm.config.builder import System
from mdm.config.recorded import Simulated, lay_out, load_recorded
from mdm.errors import Error
from mdm.models.digest import first_difference
from mdm.replay import replay_together, transports_of
from mdm.replay.replay import check_beginning
from mdm.simulation.world import simulated
from mdm.stimuli import Joined, Received

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from mdm.actors import Ensemble
    from mdm.controller import Controller
    from mdm.recording import Record
    from mdm.replay import Together
    from mdm.replay.exchange import ReplayTransport
    from mdm.stimuli import Stimulus


class Rebuilt(NamedTuple):
    """The actors of a recorded run.

    Attributes:
        actors: The system, or the ensemble of a simulation.
        ensembles: The ensembles by their paths.
        transports: Of agents of a team, the transports of their messages in a replay.
    """

    actors: System | Ensemble
    ensembles: dict[str, Ensemble]
    transports: dict[str, ReplayTransport]


def rebuilt(record: Record, folder: str | Path, given: str | Path | None = None) -> Rebuilt:
    """Return the actors of a recorded run.

    Args:
        record: The record.
        folder: Where its files are laid out.
        given: A TOML file, in place of the record's own.

    Raises:
        ConfigError: If the record has no configuration and none is given, or that cannot be loaded.
    """
    transports = transports_of(record) if "stimuli" in record.topics else {}
    if "simulation" in record.head:
        ensemble = recorded_simulation(record, folder, given)
        return Rebuilt(ensemble, {ensemble.path: ensemble}, transports)
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
    _check_same_team(record, run)
    if (different := _team_difference(record, run)) is not None:
        raise Error(
            f"{record.path}: {different}: agents of a team that differ refuse each other, so that one alone is "
            f"replayed as it ran; mdm replay FOLDER --config, with the records of all of them, replays a team of "
            f"another configuration"
        )
    return run


def recorded_simulation(record: Record, folder: str | Path, given: str | Path | None = None) -> Ensemble:
    """Return the ensemble of a recorded simulation.

    Args:
        record: The record; its head has the simulation.
        folder: Where files of the record are laid out.
        given: A TOML file, in place of the simulation's own.

    Raises:
        Error: If the head says nothing that can be simulated, or as `Simulated.options`.
    """
    try:
        told = msgspec.json.decode(record.head["simulation"], type=Simulated)
    except msgspec.MsgspecError as error:
        raise Error(f"{record.path}: its head does not say what was simulated: {error}") from None
    if given is not None:
        told = msgspec.structs.replace(told, file=str(given), ensemble=told.ensemble if told.file else None)
        return simulated(**told.options(), seed=told.seed)
    if told.file is None and (told.model is None or told.policy is None):
        raise Error(f"{record.path}: its head does not say what was simulated: neither a file nor model and policy")
    here = lay_out(record, folder)
    files = {name: file for name in ("file", "model", "policy") if (file := getattr(told, name)) is not None}
    for file in files.values():
        if Path(file).name != file:
            raise Error(f"{record.path}: its head says that {file!r} was simulated, which is not a plain file name")
    placed = {name: str(here / file) for name, file in files.items()}
    return simulated(**msgspec.structs.replace(told, **placed).options(), seed=told.seed)


# -- Teams -------------------------------------------------------------------------------------------------------


def replay_team(records: Mapping[str, Record], given: str | Path | None = None, *, most: int = 100) -> Together:
    """Replay the records of a team's agents together, each with its own configuration, or all with another one.

    Args:
        records: The records, by names of theirs.
        given: A TOML file, in place of the records' own.
        most: How many differences of each are kept.

    Raises:
        ConfigError: If a record has no configuration, or the one to take cannot be loaded.
        Error: If a record cannot be replayed, or, for another configuration, if the records are not repeated as they
            are with that of their run: then nothing is known of the messages.
    """
    with ExitStack() as folders:
        _check_alike(records)
        if given is None:
            return _replay(_each(rebuilt_to_compare, records, folders), records, most)
        runs = _each(rebuilt, records, folders, given)
        for name, run in runs.items():
            _check_same_team(records[name], run)
        teams = [(record, runs[name]) for name, record in records.items() if runs[name].transports]
        if all(isinstance(run.actors, System) and _team_difference(record, run) is None for record, run in teams):
            result = _replay(runs, records, most)
            if result.same or not teams or not all("configuration" in record.head for record in records.values()):
                return result
            # What nobody compares may differ, too: predicates, or how a state is made of them.
            runs = _each(rebuilt, records, folders, given)
        for record in records.values():
            if "configuration" not in record.head:
                raise Error(
                    f"{record.path}: the record has no configuration of its run, by which it would be known what its "
                    f"agent sent: so what another one would have decided cannot be told; mdm run --record keeps it"
                )
        as_recorded = _replay(_each(rebuilt_to_compare, records, folders), records, 1)
        if not as_recorded.same:
            at = next(iter(records.values())).path.parent
            raise Error(
                f"{at}: with the configuration of their run the records are not repeated as they are, of which mdm "
                f"replay {at} tells: so what another one would have decided cannot be told"
            )
        return _replay(runs, records, most, as_recorded)


def _each(
    make: Callable[..., Rebuilt], records: Mapping[str, Record], folders: ExitStack, *given: str | Path
) -> dict[str, Rebuilt]:
    """Return the actors of each run, with its files in a folder of its own."""
    return {
        name: make(record, folders.enter_context(tempfile.TemporaryDirectory()), *given)
        for name, record in records.items()
    }


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


def _check_same_team(record: Record, run: Rebuilt) -> None:
    """Refuse to repeat an agent in a team of another name, or of other agents: it would send under other keys.

    Raises:
        Error: With the difference, and the name or agents of the run.
    """
    if not isinstance(run.actors, System) or run.actors.member is None:
        return
    from mdm.team.transport.keys import team_of  # noqa: PLC0415 - files without a team load nothing of teams

    team = run.actors.member.link.team
    now = {"team's agents": ", ".join(team.names), "team's name": team.name}
    for stimulus in _stimuli(record):
        if isinstance(stimulus, Received):
            then = {"team's name": team_of(stimulus.key)}
        else:
            then = stimulus.facts if isinstance(stimulus, Joined) else {}
        for fact, is_now in now.items():
            if then.get(fact, is_now) != is_now:
                verb = "were" if fact.endswith("agents") else "was"
                raise Error(
                    f"{record.path}: the {fact} {verb} {then[fact]} in the run, and {is_now} in this configuration: "
                    f"give one whose team has the name of the run's, and its agents in their order"
                )
        if isinstance(stimulus, Received):
            return


def _team_difference(record: Record, run: Rebuilt) -> str | None:
    """Return in words the first fact of a team's agent that is another than in its run; None if none is.

    Raises:
        Error: If the record is of an agent of a team, and the system is none.
    """
    joined = next((each for each in _stimuli(record) if isinstance(each, Joined)), None)
    if joined is None or not isinstance(run.actors, System):
        return None
    if run.actors.member is None:
        raise Error(f"{record.path}: it is of agent {joined.agent!r} of a team, and the configuration is of none")
    now = run.actors.member.link.configuration.facts
    for fact, was in joined.facts.items():
        if now.get(fact, was) != was:
            return f"{fact} is {now[fact]}, and was {was} in the run, of mdm {record.head['mdm']}"
    return None


def _stimuli(record: Record) -> Iterator[Stimulus]:
    """Yield the stimuli of a record, none where it has no such topic."""
    if "stimuli" in record.topics:
        yield from (each.message for each in record.messages(["stimuli"]))


# -- Differences -------------------------------------------------------------------------------------------------


def check_digests(record: Record, ensembles: Iterable[Ensemble]) -> None:
    """Refuse to repeat a run with another model or policy than it had.

    Raises:
        Error: Of the first ensemble whose digest differs.
    """
    for ensemble in ensembles:
        if (absent := getattr(ensemble.controller.policy, "absent", None)) is not None:
            raise Error(
                f"{record.path}: {absent}: mdm.testing.replay(record, actors) replays it with the program's own actors"
            )
        known = record.metadata.get(f"ensemble {ensemble.path}", {})
        now = {"configuration": ensemble.controller.configuration}
        if known.get("configuration", now["configuration"]) == now["configuration"]:
            continue
        now |= ensemble.controller.digests()
        different = [name for name in ("model", "policy", "options") if known.get(name, now[name]) != now[name]]
        name = different[0] if different else "configuration"
        digests = f"digest of the {name} {now[name][:12]}, then {known[name][:12]}"
        raise Error(
            f"{record.path}: the {' and '.join(different) or name} of ensemble {ensemble.path!r} is not that "
            f"of the run ({different_part(known, ensemble.controller) or digests}): mdm "
            f"{record.head.get('mdm', 'unknown')} may have read them otherwise, or a function makes them; with "
            f"--config a configuration of yours is compared"
        )


def different_part(known: Mapping[str, str], controller: Controller) -> str | None:
    """Return in words the first part of a model, policy or options that is another than in a run.

    Args:
        known: The facts of the ensemble in the record's head.
        controller: The present controller.

    Returns:
        The sentence; None where the head has no parts, as those of older records, or none of them differs.
    """
    try:
        then = msgspec.json.decode(known.get("parts", "{}"), type=dict[str, str])
    except msgspec.MsgspecError:
        return None
    now = controller.parts()
    for part in dict.fromkeys((*then, *now)) if then else ():
        was, is_now = then.get(part, "none"), now.get(part, "none")
        if was != is_now:
            digested = was.startswith("#") or is_now.startswith("#")
            return f"it differs in the {part}" if digested else f"the {part} was {was}, and is {is_now}"
    return None


def different_entry(record: Record, ensembles: Mapping[str, Ensemble]) -> str | None:
    """Return in words the first entry by which the model of an ensemble is another than that in a record.

    Args:
        record: The record.
        ensembles: The ensembles of another configuration, by their paths.

    Returns:
        The sentence; None where the record's model cannot be loaded from it, or no entry differs.
    """
    if "configuration" not in record.head or "agent" in record.head:
        return None
    with tempfile.TemporaryDirectory() as folder:
        try:
            system = load_recorded(record, folder)
        except Error:
            return None
        for then in system.ensembles.values():
            model, now = then.controller.model, ensembles.get(then.path)
            if model is not None and now is not None and now.controller.model is not None:
                told = first_difference(model, now.controller.model)
                if told is not None:
                    return f"of the model of {then.path!r} {told}"
    return None
