"""Writing ProbModelXML: a variable for each factor and slice, potentials as tables and trees, names as MADP reads them.

MADP finds a variable by the beginning of its name, within quotes of either kind; it cuts what ends with a bracket two
characters before that, wherever it stands, and then the blanks, but for those after a first letter.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from itertools import islice, pairwise
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError, ModelWarning
from mdm.formats.markup import quoted
from mdm.formats.target import write_text
from mdm.formats.writers import Speller, initial, unused, utilities
from mdm.models.factored.factoring import as_network, unlinked
from mdm.models.factored.two_slice import Node, Potential, Table, tabulated

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from mdm.models import MDP, TwoSliceNetwork
    from mdm.models.factored.two_slice import Role

__all__ = ["Names", "write"]

_DEEPEST = 20
_SLICES: dict[Role, int] = {"state": 0, "action": 0, "next_state": 1, "observation": 1}
_FOREIGN = "^\\s+|\\s+$|[\x00-\x1f\ud800-\udfff\ufffe\uffff]"
_BRACKETS = r"\[(?=[^\[\]]*\]$)|\]+$"
"""A bracket that ends a name, with the one that it closes."""
_SLICE = r"\s*\[[01]\]"
"""What readers take for a time slice in a name."""


def write(model: MDP, path: str | Path) -> None:
    """Write a model as ProbModelXML; a flat model is factored by the chain rule over its spaces' factors.

    The discount becomes a property of the network that other readers do not know. Variables get unique names. The
    marks of fully observed factors are lost, with a warning.

    Raises:
        ModelError: If a state factor has only one value, which the format treats as a constant, or the model is too
            large for tables.
        FormatError: If the file cannot be written.
    """
    network = as_network(model)
    for factor in network.states.factors:
        if len(factor) == 1:
            raise ModelError(
                f"state factor {factor.name!r} has one value, a constant in ProbModelXML: write .pomdpx, "
                f"or an archive (.npz)"
            )
    roles: dict[Role, str] = {"state": "initial values of state factors", "observation": "observations"}
    for role, what in roles.items():
        free = unlinked(network, role)
        if free is None:
            text = f"the {what} depend on each other, and MADP does not read the links between them"
            warnings.warn(text, ModelWarning, stacklevel=3)
        else:
            network = free
    agents, seen = len(network.actions.factors), len(network.observation)
    if seen > 1 and network.event_observations:
        text = f"MADP reads one observation where it is of events, but there are {seen}"
        warnings.warn(text, ModelWarning, stacklevel=3)
    elif seen > agents or (0 < seen < agents and not network.event_observations):
        text = f"MADP reads one observation of each agent, but there are {seen} for {agents}"
        warnings.warn(text, ModelWarning, stacklevel=3)
    document = _Document(network)
    write_text(path, "\n".join(document.lines(model.discount)) + "\n")
    document.names.warn()
    if network.observations is not None and any(network.fully_observed):
        text = "ProbModelXML cannot mark fully observed factors: the marks were left out"
        warnings.warn(text, ModelWarning, stacklevel=2)


class _Document:
    def __init__(self, network: TwoSliceNetwork) -> None:
        self._network = network
        roles: tuple[Role, ...] = ("state", "action", "observation")
        nodes = [Node(role, place) for role in roles for place in range(len(network.factors(role)))]
        # A link to a decision at slice 1 marks an observation; those beyond the agents' get decisions of their own.
        agents, seen = len(network.actions.factors), len(network.factors("observation"))
        informed = [f"informed{place}" for place in range(agents, seen)]
        given = utilities(network)
        factors = [network.factors(node.role)[node.place] for node in nodes]
        rewards = [f"reward{index}" for index in range(len(given))]
        observed = range(len(nodes) - seen, len(nodes))
        self.names = Names([*(factor.name for factor in factors), *informed, *rewards], observed)
        titles = iter(self.names.variables)
        self._variables: dict[Node, str] = dict(zip(nodes, titles, strict=False))
        self._values = {node: self.names.values(factor.names) for node, factor in zip(nodes, factors, strict=True)}
        for place in range(len(network.states.factors)):
            before, after = Node("state", place), Node("next_state", place)
            self._variables[after], self._values[after] = self._variables[before], self._values[before]
        decisions = [self._variables[Node("action", place)] for place in range(agents)]
        self._informed = [*decisions[:seen], *islice(titles, len(informed))]
        self._rewards = {title: self._with_parents(utility) for title, utility in zip(titles, given, strict=True)}

    def _with_parents(self, utility: Potential) -> Potential:
        """Return a utility over a variable at least, and with each at slice 1 over its parents there.

        MADP needs both: it takes the expectation from the potentials of the variables at slice 1.
        """
        scope = list(utility.scope or [Node("action", 0)])
        for node in scope:  # which grows
            if _SLICES[node.role] == 1:
                parents = self._network.parents(node)
                scope += [parent for parent in parents if _SLICES[parent.role] == 1 and parent not in scope]
        if len(scope) == len(utility.scope):
            return utility
        table = tabulated(utility)
        added = [node for node in scope if node not in table.scope]
        values = table.values.reshape(*table.values.shape, *(1 for _ in added))
        sizes = [len(self._values[node]) for node in added]
        return Table([*table.scope, *added], np.broadcast_to(values, (*table.values.shape, *sizes)))

    def lines(self, discount: float) -> list[str]:
        network = self._network
        kind = "MDP" if network.observations is None else "POMDP" if len(network.actions.factors) == 1 else "DEC_POMDP"
        lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<ProbModelXML formatVersion="0.2.0">']
        lines += [f'<ProbNet type="{kind}">', "<AdditionalProperties>"]
        lines.append(f'<Property name="Discount" value="{discount!r}"/>')
        if network.event_observations:
            lines.append('<Property name="EventDriven" value="1"/>')
        lines.append("</AdditionalProperties>")
        if len(network.actions.factors) > 1:
            agents = range(len(network.actions.factors))
            lines += ["<Agents>", *(f"<Agent name={quoted(self._agent(agent))}/>" for agent in agents), "</Agents>"]
        lines += ["<Variables>", *self._declarations(), "</Variables>", "<Links>", *self._links(), "</Links>"]
        lines.append("<Potentials>")
        potentials: dict[Role, Sequence[Potential]] = {
            "state": initial(network),
            "next_state": network.transitions,
            "observation": network.observation,
        }
        nodes = {Node(role, place): one for role, each in potentials.items() for place, one in enumerate(each)}
        # MADP takes the first start of a variable whose name begins with that of the wanted one: it is its own.
        for node in sorted(nodes, key=lambda node: self._variables[node] if node.role == "state" else ""):
            lines += _Writer(self._reference, self._values, node).lines(nodes[node])
        for name, utility in self._rewards.items():
            lines += _Writer(self._reference, self._values, None, self._key(name, 0)).lines(utility)
        return [*lines, "</Potentials>", "</ProbNet>", "</ProbModelXML>"]

    def _agent(self, place: int) -> str:
        return self._variables[Node("action", place)]

    def _declarations(self) -> list[str]:
        network = self._network
        lines = []
        several = len(network.actions.factors) > 1
        for node, name in self._variables.items():
            role = "decision" if node.role == "action" else "chance"
            agent = self._agent(node.place) if several and role == "decision" else None
            lines.append(self._declaration(name, role, _SLICES[node.role], self._values[node], agent))
        for place, name in enumerate(self._informed):
            last = Node("action", min(place, len(network.actions.factors) - 1))
            agent = self._agent(last.place) if several else None
            lines.append(self._declaration(name, "decision", 1, self._values[last], agent))
        lines += [f'<Variable {self._key(name, 0)} type="numeric" role="utility"/>' for name in self._rewards]
        return lines

    def _declaration(self, name: str, role: str, time: int, values: list[str], agent: str | None) -> str:
        states = "".join(f"<State name={quoted(value)}/>" for value in values)
        of = "" if agent is None else f"<Agent name={quoted(agent)}/>"
        begin = f'<Variable {self._key(name, time)} type="finiteStates" role="{role}">'
        return f"{begin}{of}<States>{states}</States></Variable>"

    def _links(self) -> list[str]:
        network = self._network
        roles: tuple[Role, ...] = ("state", "next_state", "observation")
        nodes = [Node(role, place) for role in roles for place in range(len(network.potentials(role)))]
        pairs = [(self._reference(parent), self._reference(node)) for node in nodes for parent in network.parents(node)]
        pairs += [
            (self._reference(Node("observation", place)), f"<Variable {self._key(name, 1)}/>")
            for place, name in enumerate(self._informed)
        ]
        pairs += [
            (self._reference(node), f"<Variable {self._key(name, 0)}/>")
            for name, utility in self._rewards.items()
            for node in utility.scope
        ]
        return [f'<Link directed="true">{parent}{child}</Link>' for parent, child in pairs]

    def _reference(self, node: Node) -> str:
        return f"<Variable {self._key(self._variables[node], _SLICES[node.role])}/>"

    def _key(self, name: str, time: int) -> str:
        """Return the attributes that identify a variable."""
        return f'name={quoted(self.names.of(name, time))} timeSlice="{time}"'


class _Writer:
    """Writes one potential; a shared branch is written once with a label and then referenced."""

    def __init__(
        self, reference: Callable[[Node], str], values: dict[Node, list[str]], child: Node | None, utility: str = ""
    ) -> None:
        self._reference = reference
        self._values = values
        self._child = child
        self._utility = utility
        self._uses: Counter[int] = Counter()
        self._labels: dict[int, str] = {}

    def lines(self, potential: Potential) -> list[str]:
        self._count(potential)
        return self._write(potential, 0)

    def _count(self, potential: Potential) -> None:
        self._uses[id(potential)] += 1
        if isinstance(potential, Table) or self._uses[id(potential)] > 1:
            return
        for choice in sorted(set(potential.choice.tolist())):
            self._count(potential.branches[choice])

    def _write(self, potential: Potential, depth: int) -> list[str]:
        if not isinstance(potential, Table) and depth >= _DEEPEST:
            potential = tabulated(potential)
        kind = "Table" if isinstance(potential, Table) else "Tree/ADD"
        role = "utility" if self._child is None else "conditionalProbability"
        # A potential's first variable is its child.
        scope = sorted(potential.scope, key=lambda node: node != self._child)
        of = ""
        if self._child is None and not depth:
            of = f"<UtilityVariable {self._utility}/>"
        listed = scope if depth or self._child is None or self._child in scope else [self._child, *scope]
        variables = "".join(self._reference(node) for node in listed)
        lines = [f'<Potential type="{kind}" role="{role}">{of}<Variables>{variables}</Variables>']
        if isinstance(potential, Table):
            values = np.transpose(potential.values, [potential.scope.index(node) for node in scope])
            lines.append(f"<Values>{' '.join(map(repr, values.ravel(order='F').tolist()))}</Values>")
        else:
            top = self._reference(potential.node).replace("<Variable ", "<TopVariable ", 1)
            lines += [top, "<Branches>"]
            for number, branch in enumerate(potential.branches):
                names = [n for n, c in zip(self._values[potential.node], potential.choice, strict=True) if c == number]
                if names:
                    lines += self._branch(names, branch, depth)
            lines.append("</Branches>")
        return [*lines, "</Potential>"]

    def _branch(self, names: list[str], branch: Potential, depth: int) -> list[str]:
        begin = "<Branch><States>" + "".join(f"<State name={quoted(name)}/>" for name in names) + "</States>"
        key = id(branch)
        if key in self._labels:
            return [f"{begin}<Reference>{self._labels[key]}</Reference></Branch>"]
        if self._uses[key] > 1:
            self._labels[key] = f"branch{len(self._labels)}."  # MADP takes a label that has another within for both
            begin += f"<Label>{self._labels[key]}</Label>"
        return [begin, *self._write(branch, depth + 1), "</Branch>"]


class Names:
    """The names of a file's variables and their values.

    Args:
        wanted: The names that variables would have, alike or not.
        observations: The places of the observations among them.
    """

    def __init__(self, wanted: Iterable[str], observations: range) -> None:
        self._values = Speller(re.compile(f"{_FOREIGN}|{_BRACKETS}"))
        titles = Speller(re.compile(f"{_FOREIGN}|{_BRACKETS}|{_SLICE}|[\"']"))
        taken: list[str] = []
        for name in wanted:
            taken += titles.spell([name], taken, numbered=False)
        # MADP takes the first variable whose name begins with the wanted one; a slice in each name ends them.
        self._with_slices = any(after.startswith(name) for name, after in pairwise(sorted(taken)))
        self.variables = taken
        if self._with_slices:
            for place in observations:
                if len(taken[place]) == 1:
                    taken[place] = unused(f"{taken[place]}_", taken.__contains__)

    def values(self, names: Sequence[str]) -> list[str]:
        """Return the names of a variable's values."""
        return self._values.spell(names, numbered=False)

    def of(self, variable: str, time: int) -> str:
        """Return the name of a variable at a time slice, as the file has it."""
        return f"{variable} [{time}]" if self._with_slices else variable

    def warn(self) -> None:
        """Warn if names of values were changed."""
        self._values.warn("ProbModelXML")
