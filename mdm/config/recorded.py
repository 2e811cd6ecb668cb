"""The configuration in a record: the TOML file of the run and the files that it names, to run it again from them."""

from __future__ import annotations

import tempfile
import tomllib
from importlib.machinery import all_suffixes
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.config.builder import load_system, load_team
from mdm.errors import ConfigError, Error
from mdm.models.digest import first_difference
from mdm.stimuli import Joined, Received
from mdm.texts import texts_in

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from mdm.actors import Ensemble
    from mdm.config.system import System
    from mdm.controller import Controller
    from mdm.recording import Record, Recorder
    from mdm.team.transport.transport import Transport

__all__ = [
    "attach_configuration",
    "attach_file",
    "check_digests",
    "check_same_team",
    "check_team",
    "different_entry",
    "lay_out",
    "load_recorded",
    "team_difference",
]

_LARGEST = 64 * 1024 * 1024
_FOLDER = "files/"
_CODE = tuple(Path(f"_{suffix}").suffix for suffix in all_suffixes())
"""How the names of files end that Python would import."""
_DEEP = PurePosixPath("up3/up2/up1/here")
"""Where the TOML file is laid out, so that files some folders above it have a place, too."""


def attach_configuration(recorder: Recorder, path: str | Path, *, agent: str | None = None) -> None:
    """Keep a run's TOML file with its record, and the files that it names: models, policies, maps.

    Args:
        recorder: Of the run, which has not begun.
        path: The TOML file.
        agent: Of a team's file, which agent the process is.
    """
    file = Path(path).absolute()
    recorder.head(configuration=file.name, folder=str(file.parent))
    if agent is not None:
        recorder.head(agent=agent)
    for name, found in _files(file):
        recorder.attach(_FOLDER + name, "application/octet-stream", found.read_bytes())


def attach_file(recorder: Recorder, path: str | Path) -> str:
    """Keep a file, such as a model, with a run's record; return the name that it has there."""
    file = Path(path)
    recorder.attach(_FOLDER + file.name, "application/octet-stream", file.read_bytes())
    return file.name


def _files(file: Path) -> Iterator[tuple[str, Path]]:
    """Yield the file and those that it names, and files that these name, by their paths relative to its folder."""
    waiting, known = [file], {file}
    while waiting:
        found = waiting.pop(0)
        name = _relative(found, file.parent)
        if name is not None:
            yield name, found
        for named in _named(found):
            if (
                named not in known
                and named.suffix not in _CODE
                and named.is_file()
                and named.stat().st_size <= _LARGEST
            ):
                known.add(named)
                waiting.append(named)


def _relative(file: Path, folder: Path) -> str | None:
    """Return the path from a folder to a file that is at most a few folders above it; else None."""
    for ups, above in enumerate((folder, *folder.parents)[: len(_DEEP.parts)]):
        if file.is_relative_to(above):
            return str(PurePosixPath(*[".."] * ups, file.relative_to(above).as_posix()))
    return None


def _named(file: Path) -> Iterator[Path]:
    """Yield the paths that a TOML or YAML file may name."""
    if file.suffix == ".toml":
        try:
            content: Any = tomllib.loads(file.read_text(encoding="utf-8-sig"))
        except (OSError, ValueError):
            return
        texts = list(texts_in(content))
    elif file.suffix in {".yaml", ".yml"}:
        texts = [part.strip("'\"") for part in file.read_text(encoding="utf-8", errors="replace").split()]
    else:
        return
    for text in texts:
        if 0 < len(text) < 1000 and "\0" not in text and "\n" not in text:
            path = Path(text).expanduser()
            yield Path(*(file.parent / path).parts) if not path.is_absolute() else path


def load_recorded(
    record: Record, folder: str | Path, given: str | Path | None = None, *, transport: Transport | None = None
) -> System:
    """Return the system of a recorded run, whose functions are not called.

    Args:
        record: The record.
        folder: Where files of the record are laid out, such as a temporary folder.
        given: Another configuration, in place of the record's own.
        transport: Of a team's agent, the transport of its replay.

    Raises:
        ConfigError: If the record has no configuration and none is given, or that cannot be loaded.
        Error: If the record has files that have no place in a folder, or are code.
    """
    agent = record.head.get("agent")
    if given is not None:
        if agent is None and (team := load_team(given)) is not None:
            raise ConfigError(
                f"{given}: this file describes the team {team.name!r}, and {record.path} is the record of a robot "
                f"without one: give a configuration without a table [team]"
            )
        return load_system(given, agent=agent, callbacks=False, transport=transport)
    name = record.head.get("configuration")
    if name is None:
        raise ConfigError(
            f"{record.path}: the record has no configuration, for its run was no TOML file's: give the file of the "
            f"same system with --config, or call mdm.testing.replay with the actors"
        )
    if PurePosixPath(name).name != name:
        raise Error(f"{record.path}: its configuration has the name {name!r}, which is no name of a file")
    here = lay_out(record, folder)
    if not any(attached.name == _FOLDER + name for attached in record.attachments):
        raise ConfigError(
            f"{record.path}: its configuration {name!r} is not in the record, as of one that was damaged or torn "
            f"early: give the file of the same system with --config"
        )
    try:
        return load_system(here / name, agent=agent, callbacks=False, transport=transport)
    except ConfigError as error:  # of a place that will be gone
        first = error.problems[0]
        at = name if first.key is None else f"{name}: {first.key}"
        raise ConfigError(
            f"{record.path}: its configuration cannot be loaded from the record, which keeps no code: {at}: "
            f"{first.message}; give the file of the run with --config"
        ) from None


def lay_out(record: Record, folder: str | Path) -> Path:
    """Write the files that are kept with a record below a folder; return the folder of its configuration.

    Raises:
        Error: If a file is damaged, has its place elsewhere, or is code.
    """
    if record.damaged_files:
        name = record.damaged_files[0].removeprefix(_FOLDER)
        raise Error(
            f"{record.path}: the attached file {name!r} of the record is damaged: give the file of the run with "
            f"--config"
        )
    here = Path(folder) / _DEEP
    here.mkdir(parents=True)
    for attached in record.attachments:
        if attached.name.startswith(_FOLDER):
            place = (here / attached.name.removeprefix(_FOLDER)).resolve()
            if not place.is_relative_to(Path(folder).resolve()):
                raise Error(f"{record.path}: it has a file {attached.name!r}, which has no place below a folder")
            if place.suffix in _CODE:  # which would be imported from there, and a record may come from anybody
                raise Error(f"{record.path}: it has a file {attached.name!r}, which is code: no record needs it")
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(attached.data)
    return here


def check_digests(record: Record, ensembles: Iterable[Ensemble]) -> None:
    """Refuse to repeat a run with another model or policy than it had.

    Raises:
        Error: Of the first ensemble whose digest differs.
    """
    for ensemble in ensembles:
        known = record.metadata.get(f"ensemble {ensemble.path}", {})
        now = {"configuration": ensemble.controller.configuration}
        if known.get("configuration", now["configuration"]) == now["configuration"]:
            continue
        now |= ensemble.controller.digests()
        different = [name for name in ("model", "policy", "options") if known.get(name, now[name]) != now[name]]
        name = different[0] if different else "configuration"
        digests = f"digest of the {name} {now[name][:12]}, then {known[name][:12]}"
        told = different_part(known, ensemble.controller)
        raise Error(
            f"{record.path}: the {' and '.join(different) or name} of ensemble {ensemble.path!r} is not that "
            f"of the run ({digests if told is None else told}): mdm "
            f"{record.head.get('mdm', 'unknown')} may have read them otherwise, or a function makes them; with "
            f"--config a configuration of yours is compared"
        )


def different_part(known: Mapping[str, str], controller: Controller) -> str | None:
    """Return in words the first part of a model, policy or options that is another than in a run.

    Args:
        known: What the record's head says of the ensemble.
        controller: What decides now.

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
        if was == is_now:
            continue
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
            now = ensembles.get(then.path)
            models = then.controller.model, None if now is None else now.controller.model
            if models[0] is not None and models[1] is not None:
                told = first_difference(models[0], models[1])
                if told is not None:
                    return f"of the model of {then.path!r} {told}"
    return None


def check_same_team(record: Record, system: System) -> None:
    """Refuse to repeat an agent in a team of another name, or of other agents: it would send under other keys.

    Raises:
        Error: With what differs, and was in the run.
    """
    if system.member is None:
        return
    from mdm.team.transport.keys import team_of  # noqa: PLC0415 - files without a team load nothing of teams

    team = system.member.link.team
    now = {"team's agents": ", ".join(team.names), "team's name": team.name}
    for stimulus in _stimuli(record):
        then = {}
        if isinstance(stimulus, Joined):
            then = stimulus.facts
        elif isinstance(stimulus, Received):
            then = {"team's name": team_of(stimulus.key)}
        for fact, is_now in now.items():
            if then.get(fact, is_now) != is_now:
                verb = "were" if fact.endswith("agents") else "was"
                raise Error(
                    f"{record.path}: the {fact} {verb} {then[fact]} in the run, and {is_now} in this configuration: "
                    f"give one whose team has the name of the run's, and its agents in their order"
                )
        if isinstance(stimulus, Received):
            return


def _stimuli(record: Record) -> Iterator[Any]:
    """Yield the stimuli of a record, none where it has no such topic."""
    topics = [topic for topic in record.topics if topic == "stimuli"]
    return (each.message for each in record.messages(topics)) if topics else iter(())


def check_team(record: Record, system: System) -> None:
    """Refuse to repeat an agent of a team alone with another configuration than it had: its teammates would refuse it.

    Raises:
        Error: With the first fact that differs.
    """
    different = team_difference(record, system)
    if different is not None:
        raise Error(
            f"{record.path}: {different}: agents of a team that differ refuse each other, so that one alone is "
            f"replayed as it ran; mdm replay FOLDER --config, with the records of all of them, replays a team of "
            f"another configuration"
        )


def team_difference(record: Record, system: System) -> str | None:
    """Return in words the first fact of a team's agent that is another than in its run; None if none is.

    Raises:
        Error: If the record is of an agent of a team, and the system is none.
    """
    joined = next((each for each in _stimuli(record) if isinstance(each, Joined)), None)
    if joined is None:
        return None
    if system.member is None:
        raise Error(f"{record.path}: it is of agent {joined.agent!r} of a team, and the configuration is of none")
    now = system.member.link.configuration.facts
    for fact, was in joined.facts.items():
        if now.get(fact, was) != was:
            return f"{fact} is {now[fact]}, and was {was} in the run, of mdm {record.head['mdm']}"
    return None
