"""``mdm show``: a row of T, O or R by names, the start, or the network of a factored model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdm.cli.files.info import is_policy
from mdm.cli.report import as_json, printable
from mdm.cli.usage import UsageError
from mdm.errors import Error
from mdm.formats import load_model
from mdm.models import Node
from mdm.models.factored.factoring import as_network

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from mdm.models import MDP, Space
    from mdm.models.matrices import Vector


def run(arguments: argparse.Namespace) -> int:
    """Show the part; return the exit status."""
    part = arguments.part or "network"
    _check_usage(arguments, part)
    if arguments.picture is not None:
        from mdm.views.canvas import check_picture  # noqa: PLC0415

        check_picture(arguments.picture, arguments.file)
    if is_policy(arguments.file):
        raise Error(f"{arguments.file} holds a policy: use mdm info")
    model = load_model(arguments.file)
    if part == "O" and model.event_observations and arguments.before is None:
        raise UsageError("the observations of this model are events: name the previous state with --from")
    if part == "network":
        return _network(model, arguments)
    title, names, values = _row(model, part, arguments.symbols, arguments.before)
    rows = [(name, value) for name, value in zip(names, values, strict=True) if value != 0]
    if arguments.json:
        print(as_json({"row": title, "entries": [{"symbol": name, "value": value} for name, value in rows]}))
        return 0
    print(title)
    if not rows:
        print("  nothing but zeros")
    width = max((len(f"{value:g}") for _, value in rows), default=0)
    for name, value in rows:
        print(f"  {value:{width}g}  {printable(name)}".rstrip())
    return 0


def _check_usage(arguments: argparse.Namespace, part: str) -> None:
    least, most = {"T": (2, 2), "O": (2, 2), "R": (1, 4)}.get(part, (0, 0))
    if not least <= len(arguments.symbols) <= most:
        expected = str(least) if least == most else f"{least} to {most}"
        raise UsageError(f"{part} needs {expected} symbols, not {len(arguments.symbols)}")
    if arguments.picture is not None and part != "network":
        raise UsageError("--picture draws the network")
    if arguments.before is not None and part != "O":
        raise UsageError("--from is for O, where observations are events")


def _row(model: MDP, part: str, symbols: Sequence[str], before: str | None) -> tuple[str, Iterable[str], list[float]]:
    """Return a row's title, the names of its entries, and the entries."""
    states, actions = model.state_space, model.action_space
    if part == "start":
        return "the initial belief", states.names, _list(model.initial_belief)
    action = _name(actions, symbols[0])
    if part == "T":
        title = f"T: from {_name(states, symbols[1])!r} by {action!r} to"
        return title, states.names, _list(model.transition(*symbols))
    if part == "R":
        return _rewards(model, action, symbols)
    if (pomdp := model.pomdp) is None:
        raise Error("the model is an MDP: it has no observations")
    came = "" if before is None else f" from {_name(states, before)!r}"
    title = f"O: after {action!r}{came} has led to {_name(states, symbols[1])!r}"
    return title, pomdp.observation_space.names, _list(pomdp.observation(*symbols, state=before))


def _rewards(model: MDP, action: str, symbols: Sequence[str]) -> tuple[str, Iterable[str], list[float]]:
    states = model.state_space
    if len(symbols) == 1:
        column = model.rewards[:, model.action_space.index(symbols[0])]
        return f"R: for {action!r} in", states.names, _list(column)
    title = f"R: for {action!r} in {_name(states, symbols[1])!r}"
    if len(symbols) > 2:
        title += f", to {_name(states, symbols[2])!r}"
    if len(symbols) > 3:
        title += f", observing {symbols[3]!r}"
    return title, [""], [float(model.reward(*symbols))]


def _name(space: Space, symbol: str) -> str:
    return space.names[space.index(symbol)]


def _list(values: Vector) -> list[float]:
    listed: list[float] = values.tolist()
    return listed


def _network(model: MDP, arguments: argparse.Namespace) -> int:
    network = as_network(model)
    if arguments.picture is not None:
        from mdm.views.picture import draw  # noqa: PLC0415

        draw(network, arguments.picture)
    # Each variable, its number of values (0 for a reward), and its parents.
    lines: list[tuple[str, int, list[str]]] = [(f.name, len(f), []) for f in network.actions.factors]
    for role in ("state", "next_state", "observation"):
        for place, factor in enumerate(network.factors(role)):
            node = Node(role, place)
            lines.append((network.name(node), len(factor), [network.name(other) for other in network.parents(node)]))
    for index, utility in enumerate(network.utilities):
        lines.append((f"reward {index + 1}", 0, [network.name(node) for node in utility.scope]))
    if arguments.json:
        print(as_json([{"variable": name, "values": size, "depends_on": on} for name, size, on in lines]))
        return 0
    if model.network is None:
        print("(the model is not factored: its variables have all possible parents)")
    for name, size, on in lines:
        values = f" ({size} values)" if size else ""
        print(f"{name}{values}" + (f" <- {', '.join(on)}" if on else ""))
    if arguments.picture is not None:
        print(f"{arguments.picture}: drawn")
    return 0
