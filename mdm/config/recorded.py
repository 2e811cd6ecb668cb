"""The configuration in a record: the TOML file of the run and the files that it names, to run it again from them."""

from __future__ import annotations

import tomllib
import zlib
from contextlib import contextmanager
from importlib.machinery import all_suffixes
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import msgspec

from mdm.config.builder import Builder, load_system, load_team
from mdm.config.description import CONFIGURATION, FOLDER, LARGEST, PACKED, Description, stand_in
from mdm.errors import ConfigError, Error
from mdm.formats import load_model
from mdm.loading import pair_of
from mdm.texts import texts_in

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mdm.actors import Ensemble
    from mdm.config.builder import System
    from mdm.recording import Record, Recorder
    from mdm.team.transport.transport import Transport

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
        recorder.attach(FOLDER + name, "application/octet-stream", found.read_bytes())


def attach_file(recorder: Recorder, path: str | Path) -> str:
    """Keep a file, such as a model, with a run's record; return the name that it has there."""
    file = Path(path)
    recorder.attach(FOLDER + file.name, "application/octet-stream", file.read_bytes())
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
            if named not in known and named.suffix not in _CODE and named.is_file() and named.stat().st_size <= LARGEST:
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
            try:
                path = Path(text).expanduser()
            except RuntimeError:  # a formula such as ~Low, which names no home
                continue
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
            f"{record.path}: the record has no configuration, since its run had no TOML file: give the file of the "
            f"same system with --config, or call mdm.testing.replay with the actors"
        )
    if PurePosixPath(name).name != name:
        raise Error(f"{record.path}: its configuration has the name {name!r}, which is not a plain file name")
    here = lay_out(record, folder)
    if not any(attached.name == FOLDER + name for attached in record.attachments):
        raise ConfigError(
            f"{record.path}: its configuration {name!r} is not in the record, as of one that was damaged or torn "
            f"early: give the file of the same system with --config"
        )
    try:
        if name == CONFIGURATION:
            return _described(here, agent, transport)
        return load_system(here / name, agent=agent, callbacks=False, transport=transport)
    except ConfigError as error:  # of a place that will be gone
        first = error.problems[0]
        at = name if first.key is None else f"{name}: {first.key}"
        raise ConfigError(
            f"{record.path}: its configuration cannot be loaded from the record, which keeps no code: {at}: "
            f"{first.message}; give the file of the run with --config"
        ) from None


def _described(here: Path, agent: str | None, transport: Transport | None) -> System:
    """Return the system of a run that a program made, by its description."""
    try:
        found = msgspec.json.decode((here / CONFIGURATION).read_bytes(), type=Description)
    except msgspec.MsgspecError as error:
        raise ConfigError(f"{CONFIGURATION}: {error}") from None
    builder = Builder(found.system, folder=here, callbacks=False)
    builder.functions.made = {reference: stand_in(each) for reference, each in found.absent.items()}
    builder.above, builder.manager, builder.memory = found.above, found.manager, False
    return builder.system(agent, transport=transport)


@contextmanager
def as_recorded(record: Record, ensembles: Iterable[Ensemble]) -> Iterator[None]:
    """Have policies that the record does not hold decide as they did, one decision after the other."""
    absent: dict[str, Any] = {
        each.path: each.controller.policy for each in ensembles if hasattr(each.controller.policy, "absent")
    }
    decisions = [each.message for each in record.messages(["decisions"])] if absent else []
    for path, policy in absent.items():
        policy.answers = iter([each.action for each in decisions if each.ensemble == path])
    yield
    for policy in absent.values():
        policy.answers = None


def lay_out(record: Record, folder: str | Path) -> Path:
    """Write the files that are kept with a record below a folder; return the folder of its configuration.

    Raises:
        Error: If a file is damaged, has its place elsewhere, or is code.
    """
    if record.damaged_files:
        name = record.damaged_files[0].removeprefix(FOLDER)
        raise Error(
            f"{record.path}: the attached file {name!r} of the record is damaged: give the file of the run with "
            f"--config"
        )
    here = Path(folder) / _DEEP
    here.mkdir(parents=True)
    for attached in record.attachments:
        if attached.name.startswith(FOLDER):
            place = (here / attached.name.removeprefix(FOLDER)).resolve()
            if not place.is_relative_to(Path(folder).resolve()):
                raise Error(f"{record.path}: it has a file {attached.name!r}, which has no place below a folder")
            if place.suffix in _CODE:  # which would be imported from there, and a record may come from anybody
                raise Error(f"{record.path}: it has a file {attached.name!r}, which is code: no record needs it")
            place.parent.mkdir(parents=True, exist_ok=True)
            data = attached.data
            if place.suffix == PACKED:
                place = place.with_suffix("")
                try:
                    data = zlib.decompressobj().decompress(data, LARGEST)
                except zlib.error:
                    raise Error(f"{record.path}: the attached file {attached.name!r} is damaged") from None
            place.write_bytes(data)
    return here


class Simulated(msgspec.Struct, frozen=True):
    """The subject of a simulation: an ensemble of a TOML file, or a model and a policy by their files.

    Attributes:
        file: The TOML file; None where it is of a model and a policy.
        ensemble: Which of the file's ensembles; by default the first.
        model: The model's file.
        policy: The policy's file.
        discount: In place of the model's own.
        false_negative: The observation that is seen where nothing is.
        steps: Decisions in an episode.
        seed: Of all chances.
    """

    file: str | None = None
    ensemble: str | None = None
    model: str | None = None
    policy: str | None = None
    discount: float | None = None
    false_negative: str | None = None
    steps: int | None = None
    seed: int | None = None

    def options(self) -> dict[str, Any]:
        """Return the arguments of `mdm.simulation.simulate`, but for the number of episodes and the seed.

        Raises:
            ConfigError: If the file has problems.
            Error: If it has no such ensemble, or none that can be simulated.
            FormatError: If the model's or the policy's file is malformed.
        """
        return self._of_file(self.file) if self.file is not None else self._of_model()

    def _of_model(self) -> dict[str, Any]:
        assert self.model is not None
        assert self.policy is not None
        model = load_model(self.model)
        if self.discount is not None:
            model = model.with_discount(self.discount)
        policy, seen = pair_of(model, self.policy, seed=self.seed, false_negative=self.false_negative)
        return {"model": seen, "policy": policy, "steps": self.steps}

    def _of_file(self, file: str) -> dict[str, Any]:
        if (team := load_team(file)) is not None:
            raise Error(
                f"{file}: this file describes the team {team.name!r}, of which no agent can be simulated alone: give "
                f"the team's --model and --policy"
            )
        system = load_system(file, callbacks=False)
        name = self.ensemble or system.top[0].name
        if name not in system.ensembles:
            raise Error(f"{file}: there is no ensemble {name!r}; there are {', '.join(system.ensembles)}")
        status, controller = system.ensembles[name].status(), system.ensembles[name].controller
        if controller.model is None:
            raise Error(f"{file}: ensemble {name!r} has no model to simulate")
        if controller.policy.num_actions != len(controller.model.action_space):
            raise Error(
                f"{file}: ensemble {name!r} runs one agent's part of a policy: give the team's --model and --policy"
            )
        return {
            "model": controller.model,
            "policy": controller.policy,
            "steps": self.steps or controller.horizon,
            "drive": status.drive,
            "on_impossible": "predict" if controller.on_impossible == "safe_action" else controller.on_impossible,
            "on_no_observation": status.on_no_observation,
            "tracker": controller.information if controller.has_own_tracker else None,
        }
