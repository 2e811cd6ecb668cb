"""Decisions of records: the chains of an ensemble over several runs, and whether a model is the one that it had."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.errors import ModelError
from mdm.estimation.chains import chains_of, joined
from mdm.messages import Decision, Mode
from mdm.recording.names import Names, names_of
from mdm.recording.reader import Record
from mdm.recording.stimuli import TRUE_STATE

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from mdm.estimation.chains import Chains
    from mdm.models.mdp import MDP
    from mdm.models.space import Space

__all__ = ["chains_of_records", "check_names", "open_records"]


def open_records(paths: Iterable[str | Path]) -> list[Record]:
    """Open the records of several runs, each once: the files that follow a split record's first one are part of it.

    Raises:
        FormatError: If a file is no record.
        ModelError: If a run is given twice, as of a record and its repaired copy.
    """
    opened = [Record(path) for path in paths]
    opened.sort(key=lambda record: record.number)  # the first files of split records find the others
    kept: list[Record] = []
    known: set[Path] = set()
    runs: dict[tuple[str, int], Record] = {}
    for record in opened:
        if record.path.resolve() in known:
            continue
        known |= {path.resolve() for path in record.paths}
        run = record.metadata.get("mdm.file", {}).get("record", "").removesuffix(" repaired")
        if run and (other := runs.setdefault((run, record.number), record)) is not record:
            raise ModelError(f"{other.path} and {record.path} are records of the same run: give one of them")
        kept.append(record)
    return kept


def chains_of_records(records: Sequence[Record], ensemble: str | None = None) -> Chains:
    """Return the chains of an ensemble from the records of one or several runs.

    What cut its stays short is known from them: when it stopped, went safe, or was recorded no more. In a simulated
    world, which tells each time step, its decisions are steps; else see `chains_of`.

    Args:
        records: The records, of which those in which it has decided nothing count for nothing.
        ensemble: Its path; it has to be given where several have decided.

    Raises:
        ModelError: If there are no decisions, or several ensembles and none is named.

    Example::

        chains = chains_of_records([mdm.recording.Record("run.mcap")], "patrol")
        report = mdm.estimation.statistics(chains, model)
    """
    told = [_Told(record) for record in records]
    paths = sorted({path for each in told for path in each.ensembles})
    if not paths:
        raise ModelError(f"there are no decisions in {', '.join(str(record.path) for record in records)}")
    if ensemble is None and len(paths) > 1:
        raise ModelError(f"several ensembles have decided: name one of {', '.join(paths)}")
    chosen = paths[0] if ensemble is None else ensemble
    if chosen not in paths:
        raise ModelError(f"no ensemble {chosen!r} has decided; there is {', '.join(paths)}")
    return joined([each.chains(chosen) for each in told if chosen in each.ensembles])


class _Told:
    """What a record tells of decisions, and of what ends them."""

    def __init__(self, record: Record) -> None:
        self._record = record
        self._decisions: list[Decision] = []
        self._modes: list[Mode] = []
        wanted = [topic for topic in ("decisions", "modes") if topic in record.topics]
        for each in record.messages(wanted):
            if isinstance(each.message, Decision):
                self._decisions.append(each.message)
            elif isinstance(each.message, Mode):
                self._modes.append(each.message)
        self.ensembles = {decision.ensemble for decision in self._decisions}

    def chains(self, ensemble: str) -> Chains:
        """Return the chains of an ensemble."""
        stops = [mode.since for mode in self._modes if mode.ensemble == ensemble and mode.mode != "deciding"]
        span = self._record.span
        assert span is not None  # there are decisions
        stepped = f"{ensemble}/{TRUE_STATE}" in self._record.topics
        hidden = all(decision.state is None for decision in self._decisions if decision.ensemble == ensemble)
        return chains_of(
            self._decisions,
            ensemble=ensemble,
            kind="steps" if stepped and not hidden else None,
            stops=[*stops, span[1]],
        )


def check_names(records: Iterable[Record], ensemble: str, model: MDP) -> None:
    """Check that a model has the states, actions and observations that an ensemble had in its runs.

    Raises:
        ModelError: With the first difference.
    """
    for record in records:
        names = names_of(record).get(ensemble, Names())
        difference = (
            _difference("action", names.actions, model.action_space)
            or _difference("state", names.states, model.state_space)
            or _difference("observation", names.observations, model.observation_space)
        )
        if difference is not None:
            raise ModelError(f"the model is not that of {ensemble!r} in {record.path}: {difference}")


def _difference(kind: str, names: Sequence[str], space: Space | None) -> str | None:
    """Return the first difference between the names in a record, if there are any, and those of a model."""
    given = () if space is None else space.names
    if names and len(names) != len(given):
        return f"there are {len(names)} {kind}s in the record, and {len(given) or 'none'} in the model"
    for place, (before, now) in enumerate(zip(names, given, strict=False)):
        if before != now:
            return f"{kind} {place} is {before!r} in the record, and {now!r} in the model"
    return None
