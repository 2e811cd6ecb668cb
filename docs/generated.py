"""Makes the pages of the reference from the code, when the site is built: names, keys of files, commands, faults."""

from __future__ import annotations

import argparse
import collections.abc
import importlib
import inspect
import re
import textwrap
import types
import typing
from pathlib import Path
from typing import Any

import msgspec

from mdm.cli import make_parser
from mdm.faults import KINDS
from mdm.team.sharing.calls import CALLS
from mdm.team.sharing.remote import CHANNELS, RETAINED

HERE = Path(__file__).parent / "reference"

PACKAGES = (
    "mdm",
    "mdm.messages",
    "mdm.actors",
    "mdm.runtime",
    "mdm.controller",
    "mdm.config",
    "mdm.logic",
    "mdm.models",
    "mdm.beliefs",
    "mdm.policies",
    "mdm.explanation",
    "mdm.estimation",
    "mdm.solvers",
    "mdm.problems",
    "mdm.formats",
    "mdm.maps",
    "mdm.simulation",
    "mdm.simulation.building",
    "mdm.verification",
    "mdm.gym",
    "mdm.team",
    "mdm.recording",
    "mdm.replay",
    "mdm.snapshots",
    "mdm.views.web",
    "mdm.latency",
    "mdm.ros2",
    "mdm.testing",
    "mdm.errors",
)
"""The packages whose public names are documented."""

TABLES = {
    "[predicates]": ("mdm.config.tables.PredicateTable", ()),
    "[events]": ("mdm.config.tables.EventTable", ()),
    "[ensembles.NAME]": ("mdm.config.tables.EnsembleTable", ("mdm.Ensemble",)),
    "[ensembles.NAME.states]": ("mdm.config.tables.StateTable", ("mdm.StateFactor",)),
    "[ensembles.NAME.observations]": ("mdm.config.tables.ObservationTable", ("mdm.ObservationFactor",)),
    "[ensembles.NAME.actions]": ("mdm.config.tables.ActionTable", ()),
    "[ensembles.NAME.search]": ("mdm.config.tables.SearchTable", ("mdm.solvers.TreeSearch",)),
    "[ensembles.NAME.shield]": ("mdm.config.tables.ShieldTable", ("mdm.shield",)),
    "[ensembles.NAME.supervision]": ("mdm.config.tables.RestartTable", ("mdm.runtime.Restart",)),
    "[ensembles.NAME.placement]": ("mdm.team.Placement", ()),
    "[places]": ("mdm.config.places.PlacesTable", ("mdm.maps.load_map",)),
    "[ros2]": ("mdm.ros2.tables.Ros2Table", ()),
    "[predicates] topic": ("mdm.ros2.tables.TopicPredicateTable", ("mdm.ros2.tables.TopicTable",)),
    "[events] topic": ("mdm.ros2.tables.TopicEventTable", ("mdm.ros2.tables.TopicTable",)),
    "[places] pose": ("mdm.ros2.tables.PoseTable", ("mdm.ros2.tables.TopicTable",)),
    "[places] navigator": ("mdm.ros2.navigator.NavigatorTable", ()),
    "[ensembles.NAME.actions] action": ("mdm.ros2.actions.GoalTable", ()),
    "[ensembles.NAME.actions] service": ("mdm.ros2.actions.CallTable", ()),
    "[ensembles.NAME.actions] publish": ("mdm.ros2.actions.PublishTable", ()),
    "[team]": ("mdm.config.team_file.TeamTable", ("mdm.Team",)),
    "[team] agents": ("mdm.team.Agent", ()),
    "[team.communication]": (
        "mdm.config.team_file.CommunicationTable",
        ("mdm.team.communication.Budget", "mdm.team.communication.ValueOfCommunication"),
    ),
    "[team.allowance]": ("mdm.config.team_file.AllowanceTable", ("mdm.team.transport.allowance.Allowance",)),
    "[[team.ceilings]]": ("mdm.team.transport.settings.Ceiling", ()),
    "mdm sweep SWEEP.toml": ("mdm.config.sweep.SweepTable", ()),
    "mdm sweep SWEEP.toml: [evaluate]": ("mdm.config.sweep.EvaluationTable", ("mdm.evaluate",)),
}
"""The tables of the TOML file: the struct that reads each, and what else says what its keys mean."""

KEYWORDS = {
    **dict.fromkeys(("BindingOptions", "ControlOptions", "DriveOptions", "SafetyOptions"), "mdm.actors.options"),
    "ControllerOptions": "mdm.options",
    "PlacesOptions": "mdm.maps.places",
    "RecorderOptions": "mdm.recording.recorder",
    "TeamOptions": "mdm.team.team",
}
"""The typed dictionaries of options, and their modules."""

_SECTIONS = re.compile(
    r"^(Args|Attributes|Returns|Raises|Yields|Example|Examples|References|Note|Source|Cost):{1,2}$", re.MULTILINE
)
_ENTRY = re.compile(r"^ {4}(\w+)(?: \([^)]*\))?: (.*(?:\n {8}.*)*)", re.MULTILINE)


def find(path: str) -> Any:
    """Return what a dotted path names."""
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def entries(thing: Any) -> dict[str, str]:
    """Return what a docstring says of each argument and attribute."""
    text = inspect.cleandoc(thing.__doc__ or "")
    found = {}
    for section in re.findall(r"^(?:Args|Attributes):\n((?: {4}.*\n?|\n)+)", text, re.MULTILINE):
        found |= {name: " ".join(meaning.split()) for name, meaning in _ENTRY.findall(section)}
    return found


def about(struct: type) -> str:
    """Return the docstring of a struct without its fields, which a table has."""
    return re.split(r"\n\n(?:Args|Attributes):\n", inspect.cleandoc(struct.__doc__ or ""))[0]


def markdown(docstring: str) -> str:
    """Return a docstring as Markdown: its sections as lists, its literals in single backticks."""
    text = inspect.cleandoc(docstring)
    text = re.sub(r"``([^`]+)``", r"`\1`", text)
    parts = _SECTIONS.split(text)
    out = [parts[0].strip()]
    for name, body in zip(parts[1::2], parts[2::2], strict=True):
        inner = textwrap.dedent(body.strip("\n"))
        if name.startswith("Example"):
            out.append(f"**{name}**\n\n```text\n{inner.strip()}\n```")
        else:
            items = re.sub(r"^(\*{0,2}\w[\w. ]*)(?: \([^)]*\))?: ", r"- **\1**: ", inner, flags=re.MULTILINE)
            items = re.sub(r"\n {4,}", "\n  ", items)
            out.append(f"**{name}**\n\n{items}")
    return "\n\n".join(out)


def signature(thing: Any, name: str) -> str:
    """Return how a class or function is called, a line for each parameter where one is too short; else its name."""
    try:
        given = inspect.signature(thing)
    except (NameError, TypeError, ValueError):  # the types of what is documented are not all at hand
        return name
    parameters = [each for each in given.parameters.values() if each.name not in {"self", "cls"}]
    shown = [words for each in parameters for words in _parameters(each)]
    kinds = [each.kind for each in parameters]
    if inspect.Parameter.KEYWORD_ONLY in kinds and inspect.Parameter.VAR_POSITIONAL not in kinds:
        shown.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
    if inspect.Parameter.POSITIONAL_ONLY in kinds:
        shown.insert(len(kinds) - kinds[::-1].index(inspect.Parameter.POSITIONAL_ONLY), "/")
    told = given.return_annotation
    result = "" if inspect.isclass(thing) or told is given.empty else f" -> {_annotation(told)}"
    line = f"{name}({', '.join(shown)}){result}"
    return line if len(line) <= 80 else "\n".join([f"{name}(", *(f"    {each}," for each in shown), f"){result}"])


def keywords(parameter: inspect.Parameter) -> Any:
    """Return the typed dictionary that a parameter stands for; None for any other parameter."""
    named = re.fullmatch(r"Unpack\[(\w+)\]", str(parameter.annotation))
    return None if named is None else find(f"{KEYWORDS[named[1]]}.{named[1]}")


def _parameters(parameter: inspect.Parameter) -> list[str]:
    """Return a parameter as it is shown; of a typed dictionary each of its keywords."""
    options = keywords(parameter)
    if options is None:
        return [_parameter(parameter)]
    return [f"{name}: {kind.__forward_arg__} = ..." for name, kind in options.__annotations__.items()]


def _parameter(parameter: inspect.Parameter) -> str:
    stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
    kind = "" if parameter.annotation is parameter.empty else f": {_annotation(parameter.annotation)}"
    if parameter.default is parameter.empty:
        return f"{stars}{parameter.name}{kind}"
    value = re.sub(r"<(?:class|object|function) ?'?([^'>]*?)'?(?: at 0x[0-9a-f]+)?>", r"\1", repr(parameter.default))
    return f"{parameter.name}{kind} = {value}" if kind else f"{parameter.name}={value}"


def _annotation(annotation: Any) -> str:
    return inspect.formatannotation(annotation).replace("'", "")


def members(thing: type) -> dict[str, Any]:
    """Return the public methods and properties that a class itself documents."""
    return {
        name: each
        for name, each in vars(thing).items()
        if not name.startswith("_")
        and isinstance(each, types.FunctionType | property | classmethod | staticmethod)
        and (each.fget if isinstance(each, property) else each).__doc__
    }


def names(package: str) -> str:
    """Return the page of a package's public names."""
    module = importlib.import_module(package)
    lines = [f"# `{package}`", "", markdown(module.__doc__ or ""), ""]
    for name in sorted(module.__all__, key=str.lower):
        thing = getattr(module, name)
        lines += [f"## `{name}`", ""]
        if inspect.ismodule(thing):
            lines += [f"The package [`{thing.__name__}`](names-{thing.__name__}.md).", ""]
            continue
        if inspect.isclass(thing) or inspect.isroutine(thing):
            lines += ["```text", signature(thing, name), "```", "", markdown(thing.__doc__ or ""), ""]
        else:
            lines += [f"A constant of type `{type(thing).__name__}`.", ""]
        for member, each in members(thing).items() if inspect.isclass(thing) else ():
            function = each.fget if isinstance(each, property) else getattr(each, "__func__", each)
            whole = f"{name}.{member}"
            form = whole if isinstance(each, property) else signature(function, whole)
            lines += ["```text", form, "```", "", markdown(function.__doc__ or ""), ""]
    return "\n".join(lines)


def keys(struct: type[msgspec.Struct], others: tuple[str, ...]) -> dict[str, tuple[str, str, str]]:
    """Return of each key of a table its type, its default, and what it means."""
    known: dict[str, str] = {}
    for each in (*inspect.getmro(struct), *map(find, others)):
        known = entries(each) | known
    hints = typing.get_type_hints(struct, include_extras=True)
    own = {name: order for order, name in enumerate(inspect.get_annotations(struct))}
    fields = sorted(msgspec.structs.fields(struct), key=lambda field: own.get(field.name, len(own)))
    return {field.name: (_type(hints[field.name]), _default(field), known.get(field.name, "")) for field in fields}


def _type(hint: Any) -> str:
    origin, given = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        bounds = given[1]
        unit = f" of {bounds.extra['unit']}" if bounds.extra else ""
        limits = [
            f"{sign} {value:g}"
            for sign, value in (("≥", bounds.ge), (">", bounds.gt), ("≤", bounds.le))
            if value is not None
        ]
        return f"{_type(given[0])}{unit} {' and '.join(limits)}"
    if origin in {typing.Union, types.UnionType}:
        return " or ".join(_type(each) for each in given if each is not type(None))
    if origin is typing.Literal:
        return " or ".join(f'`"{each}"`' for each in given)
    if origin in {list, tuple, collections.abc.Sequence}:
        return f"list of {_type(given[0])}"
    if origin is dict:
        return f"table of {_type(given[1])}"
    words = {str: "text", float: "number", int: "whole number", bool: "`true` or `false`"}
    return words.get(hint, "see below" if hint is Any else getattr(hint, "__name__", str(hint)))


def _default(field: Any) -> str:
    if field.required:
        return "required"
    if field.default is msgspec.NODEFAULT or field.default in (None, {}, ()):
        return ""
    return f"`{msgspec.json.encode(field.default).decode()}`"


def file() -> str:
    """Return the page of the keys of the TOML file."""
    lines = [
        "# Keys of the TOML file",
        "",
        "Made from the structs that read it. [The page on the file](../configuration.md) has examples, short forms and",
        "defaults that depend on others.",
        "",
    ]
    for title, (path, others) in TABLES.items():
        struct = find(path)
        lines += [f"## `{title}`", "", markdown(about(struct)), ""]
        lines += ["| key | type | default | meaning |", "| --- | --- | --- | --- |"]
        for key, (kind, default, meaning) in keys(struct, others).items():
            text = re.sub(r"``([^`]+)``", r"`\1`", meaning).replace("|", "\\|")
            lines.append(f"| `{key}` | {kind} | {default} | {text} |")
        lines.append("")
    return "\n".join(lines)


def parsers(parser: argparse.ArgumentParser, words: str) -> typing.Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield a command and all below it."""
    yield words, parser
    for action in parser._actions:  # noqa: SLF001 - argparse has no other way to see what a parser takes
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for name, each in action.choices.items():
                yield from parsers(each, f"{words} {name}")


def commands() -> str:
    """Return the page of the commands."""
    lines = ["# Commands", "", "Each as its `--help` says.", ""]
    for words, parser in parsers(make_parser(), "mdm"):
        lines += [f"## `{words}`", "", "```text", parser.format_help().rstrip(), "```", ""]
    return "\n".join(lines)


def faults() -> str:
    """Return the page of the kinds of faults."""
    lines = [
        "# Faults",
        "",
        "A `Fault` on the runtime's channel `faults` has a source (the path of the actor), a kind and a sentence.",
        "These are the kinds that the library reports; the log tells the remedy with the first fault of each.",
        "",
        "| kind | what has happened | what to do |",
        "| --- | --- | --- |",
    ]
    lines += (f"| `{kind}` | {known.meaning} | {known.remedy} |" for kind, known in sorted(KINDS.items()))
    return "\n".join([*lines, ""])


STATISTICS = (
    "mdm.runtime.RuntimeStatistics",
    "mdm.runtime.ChannelStatistics",
    "mdm.runtime.ActorStatistics",
    "mdm.runtime.statistics.DispatcherStatistics",
    "mdm.runtime.statistics.LoopStatistics",
    "mdm.runtime.statistics.LogStatistics",
    "mdm.recording.writer.RecordStatistics",
    "mdm.actors.ensemble.EnsembleStatistics",
    "mdm.actors.control.control_layer.ControlStatistics",
    "mdm.actors.actions.action_layer.ActionStatistics",
    "mdm.actors.control.planner.PlannerStatistics",
    "mdm.team.member.MemberStatistics",
    "mdm.team.replicated.ReplicatedStatistics",
    "mdm.team.centralised.messages.CentralisedStatistics",
    "mdm.team.communicating.CommunicatingStatistics",
    "mdm.team.knowledge.RecollectionStatistics",
    "mdm.team.transport.transport.TransportStatistics",
)
"""What the methods `statistics` return."""


def statistics() -> str:
    """Return the page of the statistics."""
    lines = [
        "# Statistics",
        "",
        "What the methods `statistics()` of a runtime, its channels and its actors return.",
        "",
    ]
    for path in STATISTICS:
        struct = find(path)
        known: dict[str, str] = {}
        for base in struct.__mro__:
            known = entries(base) | known if base.__doc__ else known
        lines += [f"## `{struct.__name__}`", "", markdown(about(struct)), ""]
        lines += ["| field | type | meaning |", "| --- | --- | --- |"]
        hints: dict[str, Any] = {}
        for base in reversed(struct.__mro__):
            hints |= vars(base).get("__annotations__", {})
        for field in struct.__struct_fields__:
            text = re.sub(r"``([^`]+)``", r"`\1`", known.get(field, "")).replace("|", "\\|")
            kind = str(hints[field]).replace("|", "or")
            lines.append(f"| `{field}` | {kind} | {text} |")
        lines.append("")
    return "\n".join(lines)


def _agreement(*names: str) -> tuple[str, ...]:
    """Return the paths of messages of the agreement."""
    return tuple(f"mdm.team.agreement.messages.{name}" for name in ("Commit", *names))


SENT = (
    (
        "beat",
        ("mdm.team.link.Beat",),
        "every agent, to all",
        "five times a lease, and when the agents that it hears change",
    ),
    ("leaving", (), "every agent, to all", "when it leaves in order; the body is empty"),
    (
        "ENSEMBLE/agreement/all",
        _agreement("Call", "Begin", "Ended", "Fetch"),
        "an agent of a replicated team, to all",
        "by its leader, where a term is called, begins and ends, and at each joint step; by an agent that misses steps",
    ),
    (
        "ENSEMBLE/agreement/AGENT",
        _agreement(
            *("Call", "Joined", "Stale", "Begin", "Component", "Command", "Applied", "Fetch", "Entries", "Snapshot")
        ),
        "an agent of a replicated team, to one other",
        "proposals and acknowledgements to the leader; to one agent, what it misses; all again until answered",
    ),
    (
        "ENSEMBLE/part",
        ("mdm.team.centralised.messages.Proposal",),
        "an agent of a centralised team, to the controller",
        "at each tick; where events make steps, at each event and command, every 50 ms until it is acknowledged",
    ),
    (
        "ENSEMBLE/decision",
        ("mdm.team.centralised.messages.Decision",),
        "the controller of a centralised team, to all",
        "at each step; the last one again, four times a lease",
    ),
    (
        "ENSEMBLE/update",
        ("mdm.team.communicating.Update",),
        "an agent of a communicating team, to all",
        "what its communication policy shares, once; its episode, once a lease and when agents come or go",
    ),
    (
        "predicates/changes",
        ("mdm.team.sharing.predicates.Change",),
        "an agent whose predicates or events others have asked for",
        "when one of them changes or occurs; all values, four times within `max_age`",
    ),
    (
        "CHANNEL",
        (),
        "an agent that exports the channel: [remote channels](../teams.md#remote-channels)",
        "when a message is published on it, which is the body",
    ),
)
"""What is put under the keys of an agent: the key after its own, the messages, who sends them, and when."""

ASKED = (
    (
        "predicates/follow",
        ("mdm.team.sharing.predicates.Request",),
        "mdm.team.sharing.predicates.Reply",
        "an agent whose formulas name predicates of this one, when this one begins to live",
    ),
    ("clock", (), "its time, 8 bytes: nanoseconds since 1970", "the other agents, every five seconds"),
    (
        "double",
        ("an agent, a life and an endpoint, in MessagePack",),
        "where the agent of that name listens, if it is live for this one in another life; else nothing",
        "a process that has met nobody, every ten seconds, or is refused at its start",
    ),
    (
        "ENSEMBLE/configuration",
        (),
        "the configuration of the ensemble, fact by fact, as a table",
        "an agent in which its hash differs",
    ),
    (
        "ENSEMBLE/CALL",
        ("the token of a command, or nothing",),
        "JSON, with `result` or `error`",
        "`mdm team`, and other programs, by `mdm.team.sharing.commanding.command`",
    ),
    (
        "CHANNEL",
        (),
        "the last message, where the channel is retained; else nothing",
        "an agent that imports the channel, when this one begins to live",
    ),
    (
        "@team/who",
        (),
        "the lives of each agent that it sees",
        "an agent that opens its session, so that no name is live twice",
    ),
)
"""What an agent answers: the key after its own, the question, the answer, and who asks when."""

CARRIED = ("mdm.team.copy.Part", "mdm.team.copy.Contents")
"""What others carry as bytes: of a component or part, and of a snapshot."""


def team_messages() -> str:
    """Return the page of the messages between agents."""

    def shown(path: str) -> str:
        return f"[`{find(path).__name__}`](#{find(path).__name__.lower()})" if path.startswith("mdm.") else path

    structs = bodies()
    lines = [
        "# Messages between agents",
        "",
        "Agents of a team send each other messages under keys, `mdm/TEAM/AGENT/…`; those with its own",
        "name an agent alone uses. None is retained on the way: who comes late gets the next one, or asks. Each has",
        "an envelope, with the life of its sender, its number under its key and its time; the bodies are msgpack.",
        "[Teams](../teams.md) says what they are for.",
        "",
        "## Sent",
        "",
        "| key, after the agent's | message | who sends it | when |",
        "| --- | --- | --- | --- |",
    ]
    for key, paths, sender, when in SENT:
        lines.append(f"| `{key}` | {', '.join(map(shown, paths))} | {sender} | {when} |")
    lines += [
        "",
        "## Asked",
        "",
        "| key, after the agent's | question | answer | who asks, when |",
        "| --- | --- | --- | --- |",
    ]
    for key, paths, answer, when in ASKED:
        lines.append(f"| `{key}` | {', '.join(map(shown, paths))} | {shown(answer)} | {when} |")
    lines += [
        "",
        f"A CALL is one of {', '.join(f'`{call}`' for call in CALLS)}.",
        "That an agent is there is a liveliness token of Zenoh, `@team/live/LIFE`.",
        "",
        "## Channels",
        "",
        "Of an ensemble's channels these can be exported by name; others with their type.",
        "",
        "| channel | message | retained |",
        "| --- | --- | --- |",
    ]
    lines += (
        f"| `{name}` | `{kind.__name__}` | {'yes' if name in RETAINED else 'no'} |" for name, kind in CHANNELS.items()
    )
    lines += [
        "",
        "## Bodies",
        "",
        "Arrays of these fields, in this order; or tables, where it says so. A component and a part",
    ]
    lines += ["are a `Part`, as bytes, and the body of a snapshot is `Contents`."]
    for name, struct in sorted(structs.items()):
        fields = f"`{', '.join(struct.__struct_fields__)}`"
        form = fields if struct.__struct_config__.array_like else f"A table of {fields}"
        lines += ["", f"### `{name}`", "", form, "", markdown(struct.__doc__ or "")]
    return "\n".join([*lines, ""])


def bodies() -> dict[str, Any]:
    """Return the structs that messages between agents are made of, by name."""
    paths = [path for _, messages, *_ in SENT for path in messages]
    paths += [path for _, question, answer, _ in ASKED for path in (*question, answer) if path.startswith("mdm.")]
    return {each.__name__: each for path in (*paths, *CARRIED) for each in within(find(path))}


def within(kind: Any) -> list[type]:
    """Return the structs of a type: itself, and those of its fields."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        hints = typing.get_type_hints(kind, include_extras=True)
        return [kind, *(each for hint in hints.values() for each in within(hint))]
    return [each for part in typing.get_args(kind) for each in within(part)]


def pages() -> dict[str, str]:
    """Return all pages that are made, by the names of their files."""
    made = {f"names-{package}.md": names(package) for package in PACKAGES}
    return made | {
        "file.md": file(),
        "commands.md": commands(),
        "faults.md": faults(),
        "statistics.md": statistics(),
        "team-messages.md": team_messages(),
    }


def write() -> None:
    """Write the pages."""
    for name, text in pages().items():
        path = HERE / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
