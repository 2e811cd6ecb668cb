"""Decisions of records: the chains of an ensemble over several runs, and whether a model is the one that it had.

Those of a communicating team are put together from the records of all its agents. An agent that is silent has told
something: it keeps to itself whatever would change nothing. Counted as missing at random, that falsifies the causes of
observations. Each agent's own record has all that it saw and did: its component of the observation and of the action at
each tick.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from mdm.errors import ModelError
from mdm.estimation.chains import chains_of, joined
from mdm.messages import Decision, Mode
from mdm.recording.reader import Record
from mdm.recording.table import Names, names_of, rows
from mdm.stimuli import TRUE_STATE, Joined

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from mdm.estimation.chains import Chains
    from mdm.models.mdp import MDP
    from mdm.models.space import Space


class _Told(msgspec.Struct):
    """The decisions of a record.

    Args:
        record: The record.
        decisions: The decisions by the path of the ensemble.
        stops: When each stopped or went safe, in nanoseconds.
        agent: Of a team which agent it is.
        facts: The facts that all agents of that team have in common.
    """

    record: Record
    decisions: dict[str, list[Decision]] = {}
    stops: dict[str, list[int]] = {}
    agent: str = ""
    facts: dict[str, str] = {}

    def mode_of(self, path: str) -> str | None:
        """Return the mode of the team in which an ensemble decides; None where it decides alone."""
        name = path.rpartition("/")[2]
        return self.facts.get("team's mode") if f"configuration of ensemble {name!r}" in self.facts else None


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


def chains_of_records(records: Sequence[Record], ensemble: str | None = None, model: MDP | None = None) -> Chains:
    """Return the chains of an ensemble from the records of one or several runs, of one or several agents.

    The records say when stays were cut short: when it stopped, went safe, or was recorded no more. In a simulated
    world, which tells each time step, its decisions are steps; else see `chains_of`.

    Agents of a communicating team are silent because of their observations: their decisions are put together from the
    records of all. Other teams' joint decisions are in the record of each agent, of which one counts.

    Args:
        records: The records. The result names the parts that are not counted.
        ensemble: Its path, or the end of several: ``robot`` is each ``.../robot``, and they are pooled. It has to be
            given where several have decided.
        model: Its model, of whose actions an agent of a communicating team has decided a component.

    Raises:
        ModelError: If there are no decisions, or several ensembles and none is named, or the record of an agent of a
            communicating team is missing, or one decided on events with false negatives.

    Example::

        chains = chains_of_records([mdm.recording.Record("run.mcap")], "patrol")
        report = mdm.estimation.statistics(chains, model)
    """
    told = [_told(record) for record in records]
    paths = sorted({path for each in told for path in each.decisions})
    if not paths:
        raise ModelError(f"there are no decisions in {', '.join(str(record.path) for record in records)}")
    if ensemble is None and len(paths) > 1:
        raise ModelError(f"several ensembles have decided: name one of {', '.join(paths)}")
    name = paths[0] if ensemble is None else ensemble
    chosen = {path for path in paths if _is_meant(path, name)}
    agreed = {path for each in told for path in each.decisions if each.mode_of(path) == "communicating"}
    chosen |= {path for path in agreed if any(_is_meant(path, one.rpartition("/")[2]) for one in chosen & agreed)}
    if not chosen:
        raise ModelError(f"no ensemble {name!r} has decided; there is {', '.join(paths)}")
    parts: list[Chains] = []
    agents: dict[str, list[_Told]] = defaultdict(list)
    for each in told:
        for path in sorted(chosen & each.decisions.keys()):
            _check_steps(each.record, path)
            if each.mode_of(path) is None:
                parts.append(_chains(each, path))
            else:
                agents[path].append(each)
    if agents and all(each.mode_of(path) == "communicating" for path, several in agents.items() for each in several):
        parts.append(chains_of(_joint_decisions(agents, name, model), kind="steps"))
    elif agents:
        most = max(agents, key=lambda path: sum(len(each.decisions[path]) for each in agents[path]))
        parts += [_chains(each, most) for each in agents[most]]
        chosen -= agents.keys() - {most}
    unused = tuple(
        f"{each.record.path}: {', '.join(rest) if (rest := sorted(each.decisions.keys() - chosen)) else 'no decisions'}"
        for each in told
        if not each.decisions or each.decisions.keys() - chosen
    )
    return msgspec.structs.replace(joined(parts), ensemble=name, unused=unused)


def _check_steps(record: Record, ensemble: str) -> None:
    """Refuse an ensemble that decided on events with false negatives: its number of steps is not known."""
    parts = record.metadata.get(f"ensemble {ensemble}", {}).get("parts", "{}")
    if msgspec.json.decode(parts).get("model's false negative", "None") != "None":
        raise ModelError(
            f"{ensemble!r} decided on events with false negatives: steps without a detection are not in {record.path}; "
            "at a fixed rate each step is known"
        )


def _is_meant(path: str, name: str) -> bool:
    return path == name or path.endswith(f"/{name}")


def _told(record: Record) -> _Told:
    """Return the decisions of a record, and the times that end them."""
    told = _Told(record)
    wanted = [topic for topic in ("decisions", "modes") if topic in record.topics]
    for each in record.messages(wanted):
        if isinstance(each.message, Decision):
            told.decisions.setdefault(each.message.ensemble, []).append(each.message)
        elif isinstance(each.message, Mode) and each.message.mode != "deciding":
            told.stops.setdefault(each.message.ensemble, []).append(each.message.since)
    if told.decisions and "stimuli" in record.topics:
        for each in record.messages(["stimuli", "decisions"]):
            if isinstance(each.message, Joined):
                told.agent, told.facts = each.message.agent, each.message.facts
            if isinstance(each.message, Joined | Decision):
                break
    return told


def _chains(told: _Told, ensemble: str) -> Chains:
    """Return the chains of an ensemble from one record."""
    span = told.record.span
    assert span is not None  # there are decisions
    stepped = f"{ensemble}/{TRUE_STATE}" in told.record.topics
    hidden = all(decision.state is None for decision in told.decisions[ensemble])
    stops = told.stops.get(ensemble, [])
    chains = chains_of(
        told.decisions[ensemble], kind="steps" if stepped and not hidden else None, stops=[*stops, span[1]]
    )
    listed = rows(told.record, ensemble)
    ended = [row for row in listed if row.end is not None]
    paid = {row.decision.time: row.true_reward for row in listed if row.true_reward is not None}
    last = {row.decision.time: row.ended for row in ended if row.end == "succeeded" and row.ended in stops}
    parts = (
        msgspec.structs.replace(
            chain,
            succeeded=last.get(chain.decisions[-1].time),
            paid=tuple(paid.get(each.time, 0.0) for each in chain.decisions) if paid else (),
        )
        for chain in chains.chains
    )
    counts = Counter((row.decision.state, row.decision.action, str(row.end)) for row in ended)
    return msgspec.structs.replace(chains, chains=tuple(parts), ends=tuple((*key, n) for key, n in counts.items()))


def check_names(records: Iterable[Record], ensemble: str, model: MDP) -> None:
    """Check that a model has the states, actions and observations that an ensemble had in its runs.

    Args:
        records: The records.
        ensemble: See `chains_of_records`.
        model: The model.

    Raises:
        ModelError: With the first difference.
    """
    named = [
        (record, names) for record in records for path, names in names_of(record).items() if _is_meant(path, ensemble)
    ]
    for record, names in named:
        difference = (
            _difference("action", names.actions, model.action_space)
            or _difference("state", names.states, model.state_space)
            or _difference("observation", names.observations, model.observation_space)
        )
        if difference is not None:
            raise ModelError(f"the model differs from that of {ensemble!r} in {record.path}: {difference}")


def _difference(kind: str, names: Sequence[str], space: Space | None) -> str | None:
    """Return the first difference between the names in a record, if there are any, and those of a model."""
    given = () if space is None else space.names
    if names and len(names) != len(given):
        return f"there are {len(names)} {kind}s in the record, and {len(given) or 'none'} in the model"
    for place, (before, now) in enumerate(zip(names, given, strict=False)):
        if before != now:
            return f"{kind} {place} is {before!r} in the record, and {now!r} in the model"
    return None


def _joint_decisions(agents: Mapping[str, Sequence[_Told]], ensemble: str, model: MDP | None) -> Iterator[Decision]:
    """Yield the joint decisions of a communicating team, at ticks at which all agents have decided.

    Args:
        agents: The records by the path of the ensemble at each agent.
        ensemble: The name of the ensemble.
        model: Its model.

    Raises:
        ModelError: If there is no model, a record of an agent is missing, or two of one agent are of the same time.
    """
    by_agent = {each.agent: (path, several) for path, several in agents.items() for each in several}
    team = next(iter(agents.values()))[0].facts["team's agents"].split(", ")
    missing = [agent for agent in team if agent not in by_agent]
    if missing:
        raise ModelError(
            f"{ensemble!r} decides in a communicating team, whose agents are silent because of what they saw, not by "
            f"chance: give the records of {', '.join(team)} together (missing: {', '.join(missing)})"
        )
    if model is None:
        raise ModelError(f"{ensemble!r} decides in a communicating team: its model has to say whose each action is")
    own = [dict(_own(*by_agent[agent], place, model)) for place, agent in enumerate(team)]
    previous: tuple[int, ...] = ()
    for number, tick in enumerate(sorted(set.intersection(*map(set, own)))):
        parts = [each[tick] for each in own]
        epochs = tuple(part[0].epoch for part in parts)
        follows = previous and epochs == tuple(epoch + 1 for epoch in previous)
        previous = epochs
        action = model.action_space.ravel([part[1] for part in parts])
        yield Decision(
            parts[0][0].time,
            ensemble,
            number,
            "tick" if follows else "start",
            None,
            tuple(part[2] for part in parts),
            parts[0][0].belief,
            action,
            model.action_space.names[action],
            None,
        )


def _own(
    path: str, records: Sequence[_Told], place: int, model: MDP
) -> Iterator[tuple[int, tuple[Decision, int, int | None]]]:
    """Yield by the number of the tick an agent's decisions, with its components of the action and the observation."""
    decisions = [(each, decision) for each in records for decision in each.decisions[path]]
    times = sorted(decision.time for _, decision in decisions)
    gaps = [later - earlier for earlier, later in pairwise(times)]
    period = median(gaps) if gaps else 1
    if len(set(times)) < len(times):
        raise ModelError(f"two records of {path!r} overlap: count the runs of a communicating team separately")
    for told, decision in decisions:
        names = names_of(told.record).get(path, Names())
        seen = decision.observation
        factors = names.observation_factors.values() or (model.observation_space or model.state_space).factors
        if isinstance(seen, int):
            seen = int(np.unravel_index(seen, [len(factor) for factor in factors])[place])
        elif seen is not None:
            seen = seen[place]
        yield round(decision.time / period), (decision, model.action_space.unravel(decision.action)[place], seen)
