"""OpenMarkov's ProbModelXML format (``.pgmx``): factored models with tables and trees, events and teams.

Chance variables at time slice 0 are state factors, decisions there are actions, and chance variables linked to a
decision at slice 1 are observations. Potentials are tables (the first variable changes fastest), uniform, or trees with
labelled, shared branches. The format has no discount: it is 1, or the network's property ``Discount``.

MADP finds a variable by the beginning of its name, within quotes of either kind; it cuts a name that ends with a
bracket two characters before that, wherever it stands, and then the blanks, but for those after a first letter.
"""

from __future__ import annotations

import math
import re
import warnings
from collections import Counter
from itertools import islice, pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.errors import ModelError, ModelWarning
from mdm.formats.markup import Element, quoted, stream
from mdm.formats.source import Source, number
from mdm.formats.target import write_text
from mdm.formats.writers import Speller, initial, unused, utilities
from mdm.models import Factor, FactoredMDP, FactoredPOMDP, Space
from mdm.models.factored.factoring import as_network, unlinked
from mdm.models.factored.two_slice import Node, Potential, PotentialError, Table, Tree, TwoSliceNetwork, tabulated
from mdm.models.validation import placing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from mdm.models import MDP
    from mdm.models.factored.two_slice import Role

_WHOLE = {"Variable", "Links", "Agents", "Potential", "AdditionalProperties", "Policies", "Comment", "Constraints"}
_TABLES = {"Table", "ProbTable", "Exact"}
_TREES = {"Tree/ADD", "Tree-ADD"}
_LARGEST = 20_000_000
_DEPTH = 100
"""Limit on chains of references between branches; real models stay far below."""


def read(path: str | Path, *, sparse: bool | None = None) -> FactoredMDP | FactoredPOMDP:
    """Read a factored model.

    Args:
        path: The file.
        sparse: Force CSR (True) or dense (False) matrices when it is flattened; None chooses.

    Raises:
        FormatError: If the file is malformed, with the place and the expected form.
    """
    source = Source(path)
    document = _Document(source)
    try:
        with placing(lambda node, text: document.element(node).fail(text)):
            network = document.network()
            if network.observations is None:
                return FactoredMDP(network, discount=document.discount, sparse=sparse)
            return FactoredPOMDP(network, discount=document.discount, sparse=sparse)
    except PotentialError as error:
        document.element(error.node).fail(str(error))
    except ModelError as error:
        source.fail(str(error))


class _Document:
    def __init__(self, source: Source) -> None:
        self.source = source
        self.discount = 1.0
        self._event_driven = False
        self._variables: dict[tuple[str, int], Variable] = {}
        self._links: list[tuple[tuple[str, int], tuple[str, int]]] = []
        self._agents: list[str] = []
        self._elements: dict[tuple[str, int], Element] = {}
        self._keys: dict[Node, tuple[str, int]] = {}
        self._nodes: dict[tuple[str, int], Node] = {}
        root = None
        in_policies = False
        for element in stream(source, _WHOLE):
            if root is None:
                root = element
                if root.tag != "ProbModelXML":
                    root.fail(f"<ProbModelXML> was expected, not <{root.tag}>")
            elif element.tag == "Variable":
                self._add_variable(element)
            elif element.tag == "Links":
                self._links = [self._link(link) for link in element.all("Link")]
            elif element.tag == "Agents":
                self._agents = [agent.attribute("name") for agent in element.all("Agent")]
            elif element.tag == "AdditionalProperties":
                self._read_properties(element)
            elif element.tag == "Policies":
                in_policies = True
            elif element.tag == "Potential" and not in_policies:
                self._add_potential(element)

    def _add_variable(self, element: Element) -> None:
        name, time = reference(element)
        role = element.attribute("role")
        if time is None and role == "utility":
            time = 0  # some files omit the slice: the utility is received at each step
        if time is None or time not in {0, 1}:
            element.fail(
                f"variable {name!r} has no time slice; a decision process has the slices 0 and 1"
                if time is None
                else f"variable {name!r} has time slice {time}; a decision process has the slices 0 and 1"
            )
        if role not in {"chance", "decision", "utility"}:
            element.fail(f"variable {name!r} has the role {role!r}: chance, decision or utility was expected")
        if (name, time) in self._variables:
            element.fail(f"variable {name!r} of time slice {time} is declared twice")
        names = names_of(element)
        if not names and role != "utility":
            element.fail(f"variable {name!r} has no states")
        agent = element.find("Agent")
        self._variables[name, time] = Variable(
            name, time, role, names, None if agent is None else agent.attribute("name"), element
        )

    def _link(self, link: Element) -> tuple[tuple[str, int], tuple[str, int]]:
        ends = link.all("Variable")
        if len(ends) != 2:
            link.fail(f"a link joins two variables, not {len(ends)}")
        parent, child = (self._variable(end) for end in ends)
        return parent.key, child.key

    def _variable(self, element: Element) -> Variable:
        name, time = reference(element)
        found = self._variables.get((name, 0 if time is None else time))
        if found is None:
            element.fail(f"there is no variable {name!r} of time slice {0 if time is None else time}")
        return found

    def _read_properties(self, element: Element) -> None:
        for item in element.all("Property"):
            name, value = item.attribute("name"), item.attributes.get("value", "").strip()
            if name == "EventDriven":
                self._event_driven = value not in {"0", ""}
            elif name == "Discount":
                discount = number(value)
                if discount is None or not 0 < discount <= 1:
                    item.fail(f"a discount is more than 0 and at most 1, not {value!r}")
                self.discount = discount

    def _add_potential(self, element: Element) -> None:
        utility = element.find("UtilityVariable")
        if utility is None:
            listed = element.find("Variables")
            first = listed.find("Variable") if listed is not None else None
            if first is None:
                element.fail("a potential needs a variable")
            utility = first
        self._elements.setdefault(self._variable(utility).key, element)  # the first potential counts

    def _with_role(self, role: str, time: int) -> list[Variable]:
        return [v for v in self._variables.values() if v.role == role and v.time == time]

    def network(self) -> TwoSliceNetwork:
        """Return the document's network."""
        factors = [variable for variable in self._with_role("chance", 0) if len(variable.names) > 1]
        decisions = self._with_role("decision", 0)
        if not decisions or not factors:
            missing = "decision" if not decisions else "chance variable with two states or more"
            self.source.fail(f"this is not a two-slice decision process: it has no {missing} at time slice 0")
        by_agent = not self._event_driven and len(decisions) == len(self._agents) > 1
        later = self._with_role("decision", 1)
        if by_agent:
            decisions, later = self._ordered(decisions), self._ordered(later)
        observed = [self._observed(decision) for decision in later]
        seen = [variable for variable in observed if variable is not None]
        nodes = {variable.key: Node("state", index) for index, variable in enumerate(factors)}
        nodes |= {(variable.name, 1): Node("next_state", index) for index, variable in enumerate(factors)}
        nodes |= {variable.key: Node("action", index) for index, variable in enumerate(decisions)}
        for index, variable in enumerate(seen):
            nodes.setdefault(variable.key, Node("observation", index))
        for variable in factors:
            after = self._variables.get((variable.name, 1))
            if after is not None and len(after.names) != len(variable.names):
                after.element.fail(
                    f"{variable.name!r} has {len(after.names)} states at slice 1, but {len(variable.names)} at slice 0"
                )
        self._keys = {node: key for key, node in nodes.items()}
        self._nodes = nodes
        return TwoSliceNetwork(
            Space(Factor(variable.name, variable.names) for variable in factors),
            Space(Factor(variable.name, variable.names) for variable in decisions),
            Space(Factor(variable.name, variable.names) for variable in seen) if seen else None,
            initial=[self._initial(variable, Node("state", i)) for i, variable in enumerate(factors)],
            transitions=[self._potential((variable.name, 1)) for variable in factors],
            observation=[self._observation(variable, index) for index, variable in enumerate(seen)],
            utilities=[
                self._potential(variable.key) for time in (0, 1) for variable in self._with_role("utility", time)
            ],
            event_observations=self._event_driven and bool(seen),
        )

    def element(self, node: Node) -> Element:
        """Return the element with a node's distribution."""
        return self._elements[self._keys[node]]

    def _ordered(self, decisions: list[Variable]) -> list[Variable]:
        for decision in decisions:
            if decision.agent not in self._agents:
                decision.element.fail(
                    f"decision {decision.name!r} belongs to agent {decision.agent!r}, who is not among the agents "
                    f"{', '.join(self._agents)}"
                )
        return sorted(decisions, key=lambda decision: self._agents.index(str(decision.agent)))

    def _observed(self, decision: Variable) -> Variable | None:
        parents = [self._variables[parent] for parent, child in self._links if child == decision.key]
        return next((parent for parent in parents if parent.role == "chance" and parent.time == 1), None)

    def _initial(self, variable: Variable, node: Node) -> Potential:
        if variable.key not in self._elements:
            return Table([node], np.full(len(variable.names), 1 / len(variable.names)))
        return self._potential(variable.key)

    def _observation(self, variable: Variable, index: int) -> Potential:
        node = self._nodes[variable.key]
        if node == Node("observation", index):
            return self._potential(variable.key)
        # A directly observed state factor, or an observation shared with another agent.
        return Table([node, Node("observation", index)], np.eye(len(variable.names)))

    def _potential(self, key: tuple[str, int]) -> Potential:
        if key not in self._elements:
            self.source.fail(f"variable {key[0]!r} of time slice {key[1]} has no potential")
        variable = self._variables[key]
        child = None if variable.role == "utility" else variable
        return PotentialReader(self._variable, self._nodes, self._elements[key], child).potential()


class Variable(NamedTuple):
    """A variable of one time slice."""

    name: str
    time: int
    role: str
    names: tuple[str, ...]
    agent: str | None
    element: Element

    @property
    def key(self) -> tuple[str, int]:
        """Its name and time slice, which identify it."""
        return self.name, self.time


def reference(element: Element) -> tuple[str, int | None]:
    """Return the name and time slice of a variable; files have the slice as an attribute, in the name, or both."""
    name = element.attribute("name")
    time = element.attributes.get("timeSlice")
    if time is None:
        for suffix in ("[0]", "[1]"):
            if name.endswith(suffix):
                return name.removesuffix(suffix).strip(), int(suffix[1])
        return name, None
    if not time.strip().isdecimal() or len(time) > 9:
        element.fail(f"{time[:40]!r} is not a time slice")
    return name.removesuffix(f"[{int(time)}]").strip(), int(time)


def names_of(element: Element) -> tuple[str, ...]:
    """Return the names of the states listed in an element."""
    states = element.find("States")
    return () if states is None else tuple(state.attribute("name") for state in states.all("State"))


class PotentialReader:
    """Reads one potential; a labelled branch is read once and shared by all references to it.

    Args:
        variable: Returns the variable named by an element.
        nodes: The network's nodes by name and time slice of their variable.
        root: The potential's element.
        child: The variable whose conditional probability it is; None for a utility.
    """

    def __init__(
        self,
        variable: Callable[[Element], Variable],
        nodes: Mapping[tuple[str, int], Node],
        root: Element,
        child: Variable | None,
    ) -> None:
        self._variable = variable
        self._nodes = nodes
        self._child = child
        self._labels: dict[str, Element] = {}
        self._shared: dict[str, Potential] = {}
        self._root = root
        self._find_labels(root)

    def _find_labels(self, element: Element) -> None:
        label = element.find("Label") if element.tag == "Branch" else None
        if label is not None:
            self._labels.setdefault(label.text.strip(), element)
        for inner in element.children:
            self._find_labels(inner)

    def potential(self) -> Potential:
        """Return the potential."""
        return self._read(self._root, 0)

    def _read(self, element: Element, depth: int) -> Potential:
        if depth > _DEPTH:
            element.fail(f"branches refer to each other more than {_DEPTH} deep")
        kind = element.attribute("type")
        if kind in _TREES:
            return self._tree(element, depth)
        if kind == "Uniform":
            if self._child is None:
                return Table([], 0.0)
            size = len(self._child.names)
            return Table([self._nodes[self._child.key]], np.full(size, 1 / size))
        if kind in _TABLES:
            return self._table(element)
        return element.fail(
            f"a potential of type {kind!r} is not supported; Table, ProbTable, Exact, Uniform and Tree/ADD are"
        )

    def _scope(self, element: Element) -> list[Variable]:
        listed = element.find("Variables")
        found = [] if listed is None else [self._variable(each) for each in listed.all("Variable")]
        if len({variable.key for variable in found}) != len(found):
            element.fail("a potential lists a variable twice")
        return [variable for variable in found if variable.role != "utility"]

    def _table(self, element: Element) -> Potential:
        scope = self._scope(element)
        sizes = [len(variable.names) for variable in scope]
        count = math.prod(sizes)
        if count > _LARGEST:
            element.fail(f"a table of {count} numbers exceeds the limit of {_LARGEST}")
        given = element.need("Values")
        words = given.text.split()
        try:
            values = np.array(words, dtype=np.float64)
        except ValueError:
            wrong = next(word for word in words if number(word) is None)
            given.fail(f"{wrong[:40]!r} is not a number")
        if not np.isfinite(values).all():
            given.fail(f"{words[int((~np.isfinite(values)).argmax())]} is not a finite number")
        if len(values) == 1:
            values = np.full(count, values[0])
        if len(values) != count:
            over = " x ".join(map(str, sizes)) or "1"
            given.fail(f"{len(values)} numbers are given, but the table has {over} = {count}")
        array = values.reshape(sizes[::-1]).T
        kept = [index for index, variable in enumerate(scope) if self._known(variable, element)]
        array = array[tuple(slice(None) if index in kept else 0 for index in range(len(scope)))]
        return Table([self._nodes[scope[index].key] for index in kept], array)

    def _known(self, variable: Variable, element: Element) -> bool:
        """Whether a variable is in the network; constants are not, and other variables are refused."""
        if variable.key in self._nodes:
            return True
        if len(variable.names) == 1:
            return False
        return element.fail(
            f"a potential depends on {variable.name!r} of time slice {variable.time}, which is neither state, action "
            f"nor observation: only two-slice decision processes, as MADP reads them, are supported"
        )

    def _tree(self, element: Element, depth: int) -> Potential:
        top = self._variable(element.need("TopVariable"))
        branches = element.need("Branches").all("Branch")
        choice: dict[str, int] = {}
        for index, branch in enumerate(branches):
            names = names_of(branch)
            if branch.find("Thresholds") is not None or branch.find("Threshold") is not None:
                branch.fail("branches by thresholds need numeric variables, which decision processes do not have")
            for name in names or top.names:
                if name not in top.names:
                    branch.fail(f"{top.name!r} has no state {name!r}; it has {', '.join(top.names)}")
                choice.setdefault(name, index)
        left = [name for name in top.names if name not in choice]
        if left:
            element.fail(f"the tree over {top.name!r} has no branch for {', '.join(left)}")
        potentials = [self._branch(branch, depth + 1) for branch in branches]
        if not self._known(top, element):
            return potentials[choice[top.names[0]]]
        try:
            return Tree(self._nodes[top.key], [choice[name] for name in top.names], potentials)
        except ModelError as error:
            return element.fail(str(error))

    def _branch(self, branch: Element, depth: int) -> Potential:
        inner = branch.find("Potential")
        if inner is not None:
            label = branch.find("Label")
            if label is not None:
                return self._labelled(label.text.strip(), inner, depth)
            return self._read(inner, depth)
        name = branch.need("Reference").text.strip()
        target = self._labels.get(name)
        if target is None:
            known: Sequence[str] = sorted(self._labels)
            branch.fail(f"there is no branch with the label {name!r}; there are {', '.join(known) or 'none'}")
        return self._labelled(name, target.need("Potential"), depth)

    def _labelled(self, name: str, element: Element, depth: int) -> Potential:
        if name not in self._shared:
            self._shared[name] = self._read(element, depth)
        return self._shared[name]


# -- Writing -----------------------------------------------------------------------------------------------------------

_DEEPEST = 20
_SLICES: dict[Role, int] = {"state": 0, "action": 0, "next_state": 1, "observation": 1}
_FOREIGN = "^\\s+|\\s+$|[\x00-\x1f\ud800-\udfff\ufffe\uffff]"
_BRACKETS = r"\[(?=[^\[\]]*\]$)|\]+$"
"""A bracket that ends a name, with the one that it closes."""
_SLICE = r"\s*\[[01]\]"
"""Readers take this for a time slice in a name."""


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
    document = _Written(network)
    write_text(path, "\n".join(document.lines(model.discount)) + "\n")
    document.names.warn()
    if network.observations is not None and any(network.fully_observed):
        text = "ProbModelXML cannot mark fully observed factors: the marks were left out"
        warnings.warn(text, ModelWarning, stacklevel=2)


class _Written:
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
