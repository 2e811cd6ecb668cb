"""POMDPX, the format of APPL's SARSOP: factored POMDPs with mixed observability, as tables and decision diagrams.

See https://bigbird.comp.nus.edu.sg/pmwiki/farm/appl/index.php?n=Main.PomdpXDocumentation. Models are written as SARSOP
reads them: tables and trees as entries, and no links that it refuses. Of state factors only hidden ones may depend on
others of the same slice, and these must be fully observed; no observation depends on another.
"""

from __future__ import annotations

import math
import re
import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mdm.errors import ModelError, ModelWarning
from mdm.formats.markup import Element, escape, quoted, stream
from mdm.formats.source import Source, number
from mdm.formats.target import write_text
from mdm.formats.writers import Speller, initial, unused, utilities
from mdm.models import Factor, FactoredMDP, FactoredPOMDP, Space
from mdm.models.factored.factoring import as_network, joined, unlinked
from mdm.models.factored.two_slice import Node, Potential, PotentialError, Role, Table, Tree, TwoSliceNetwork, tabulated
from mdm.models.validation import placing

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    import numpy.typing as npt

    from mdm.models import MDP

_WHOLE = {"Description", "Discount", "Variable", "CondProb", "Func"}
_ROLES: dict[str, Role] = {
    "InitialStateBelief": "state",
    "StateTransitionFunction": "next_state",
    "ObsFunction": "observation",
}
_LARGEST = 1_000_000
_MOST_NUMBERS = 50_000_000
_DEPTH = 100
"""Limit on chains of templates; real models stay far below."""


def read(path: str | Path, *, sparse: bool | None = None) -> FactoredMDP | FactoredPOMDP:
    """Read a factored model; without observation variables and with every factor fully observed, an MDP.

    Args:
        path: The file.
        sparse: Force CSR (True) or dense (False) matrices when it is flattened; None chooses.

    Raises:
        FormatError: If the file is malformed, with the place and the expected form.
    """
    document = _Document(Source(path))
    try:
        with placing(lambda node, text: document.elements[node].fail(text)):
            network = document.network()
            if network.observations is None:
                return FactoredMDP(network, discount=document.discount, sparse=sparse)
            return FactoredPOMDP(network, discount=document.discount, sparse=sparse)
    except PotentialError as error:
        document.elements[error.node].fail(str(error))
    except ModelError as error:
        document.source.fail(str(error))


class _Document:
    def __init__(self, source: Source) -> None:
        self.source = source
        self.discount = 1.0
        self._factors: dict[str, list[Factor]] = {"StateVar": [], "ActionVar": [], "ObsVar": []}
        self._fully_observed: list[bool] = []
        self._variables: dict[str, Variable] = {}
        self._rewards: set[str] = set()
        self._potentials: dict[Node, Potential] = {}
        self.elements: dict[Node, Element] = {}
        self._utilities: list[Potential] = []
        root = None
        section = ""
        discounted = False
        for element in stream(source, _WHOLE):
            if root is None:
                root = element
                if root.tag != "pomdpx":
                    root.fail(f"<pomdpx> was expected, not <{root.tag}>")
            elif element.tag == "Discount":
                self._read_discount(element)
                discounted = True
            elif element.tag == "Variable":
                self._read_variables(element)
            elif element.tag == "CondProb" and section in _ROLES:
                self._read_distribution(element, _ROLES[section])
            elif element.tag == "Func" and section == "RewardFunction":
                self._read_reward(element)
            elif element.tag in {"CondProb", "Func"}:
                element.fail(f"<{element.tag}> is not allowed in <{section or 'pomdpx'}>")
            else:
                section = element.tag
        if not discounted:
            source.fail("there is no <Discount>")

    def _read_discount(self, element: Element) -> None:
        discount = number(element.text.strip())
        if discount is None or not 0 < discount <= 1:
            element.fail(f"a discount is more than 0 and at most 1, not {element.text.strip()[:40]!r}")
        self.discount = discount

    def _read_variables(self, element: Element) -> None:
        for variable in element.children:
            if variable.tag == "StateVar":
                seen = variable.attributes.get("fullyObs", "false").strip().lower()
                if seen not in {"true", "false", "0", "1"}:
                    variable.fail(f"fullyObs is true or false, not {seen!r}")
                factor = self._add(variable, "vnamePrev", "state", "s")
                self._fully_observed.append(seen in {"true", "1"})
                name = variable.attribute("vnameCurr")
                self._name(variable, name, Variable(Node("next_state", len(self._fully_observed) - 1), factor))
            elif variable.tag == "ActionVar":
                self._add(variable, "vname", "action", "a")
            elif variable.tag == "ObsVar":
                self._add(variable, "vname", "observation", "o")
            elif variable.tag == "RewardVar":
                self._rewards.add(variable.attribute("vname"))
            else:
                variable.fail(f"StateVar, ActionVar, ObsVar or RewardVar was expected, not <{variable.tag}>")

    def _add(self, element: Element, attribute: str, role: Role, prefix: str) -> Factor:
        name = element.attribute(attribute)
        values = element.find("ValueEnum")
        names: list[str] | int
        if values is not None:
            names = values.text.split()
        else:
            count = element.need("NumValues").text.strip()
            if not count.isdecimal() or len(count) > 9 or not 0 < int(count) <= _LARGEST:
                element.need("NumValues").fail(f"a number of values from 1 to {_LARGEST} was expected, not {count!r}")
            names = int(count)
        try:
            factor = Factor(name, names, prefix=prefix)
        except ModelError as error:
            element.fail(str(error))
        factors = self._factors[element.tag]
        self._name(element, name, Variable(Node(role, len(factors)), factor))
        factors.append(factor)
        return factor

    def _name(self, element: Element, name: str, variable: Variable) -> None:
        if name in self._variables:
            element.fail(f"two variables are called {name!r}")
        self._variables[name] = variable

    def _read_distribution(self, element: Element, role: Role) -> None:
        stated = element.need("Var")
        child = self._variables.get(stated.text.strip())
        if child is None or child.node.role != role:
            names = [name for name, variable in self._variables.items() if variable.node.role == role]
            stated.fail(f"a variable among {', '.join(names) or 'none'} was expected, not {stated.text.strip()!r}")
        if child.node in self._potentials:
            stated.fail(f"{stated.text.strip()!r} has a distribution already")
        self._potentials[child.node] = function(element, self._variables, child)
        self.elements[child.node] = element

    def _read_reward(self, element: Element) -> None:
        stated = element.need("Var")
        if stated.text.strip() not in self._rewards:
            stated.fail(f"there is no RewardVar {stated.text.strip()!r}")
        self._utilities.append(function(element, self._variables, None))

    def network(self) -> TwoSliceNetwork:
        """Return the document's network."""
        states, actions, observations = (self._factors[kind] for kind in ("StateVar", "ActionVar", "ObsVar"))
        for factors, kind in ((states, "StateVar"), (actions, "ActionVar")):
            if not factors:
                self.source.fail(f"no <{kind}> is declared")
        space = Space(observations) if observations else None
        seen = self._distributions("observation", observations)
        if space is None and not all(self._fully_observed):
            # Without observation variables, a POMDP needs an observation of a single, uninformative symbol.
            space = Space.single("nothing", ["nothing"])
            seen = [Table([Node("observation", 0)], [1.0])]
        return TwoSliceNetwork(
            Space(states),
            Space(actions),
            space,
            initial=self._initial(states),
            transitions=self._distributions("next_state", states),
            observation=seen,
            utilities=self._utilities,
            fully_observed=self._fully_observed,
        )

    def _initial(self, states: list[Factor]) -> list[Potential]:
        if any(node.role == "state" for node in self._potentials):
            return self._distributions("state", states)
        warnings.warn(
            f"{self.source.path}: no initial belief is given; it is read as uniform", ModelWarning, stacklevel=5
        )
        return [Table([Node("state", i)], np.full(len(f), 1 / len(f))) for i, f in enumerate(states)]

    def _distributions(self, role: Role, factors: list[Factor]) -> list[Potential]:
        section = next(name for name, of in _ROLES.items() if of == role)
        for place, factor in enumerate(factors):
            if Node(role, place) not in self._potentials:
                self.source.fail(f"<{section}> has no <CondProb> for {factor.name!r}")
        return [self._potentials[Node(role, place)] for place in range(len(factors))]


class Variable(NamedTuple):
    """A variable: its node in the network, and its values."""

    node: Node
    factor: Factor


def function(element: Element, variables: Mapping[str, Variable], child: Variable | None) -> Potential:
    """Read the potential of a ``CondProb`` (with a child) or a ``Func`` (without one).

    Args:
        element: The element.
        variables: The variables in scope, by name.
        child: The variable whose distribution it is, if any.

    Raises:
        FormatError: If the element is malformed, with the place and the expected form.
    """
    parents = element.find("Parent")
    words = parents.text.split() if parents is not None else []
    scope = []
    for word in words if words != ["null"] else []:
        if word not in variables:
            assert parents is not None
            parents.fail(f"there is no variable {word!r} here; there are {', '.join(variables)}")
        scope.append(variables[word])
    if child is not None:
        scope.append(child)
    if len({variable.node for variable in scope}) != len(scope):
        element.fail("the function lists a variable twice")
    parameter = element.need("Parameter")
    kind = parameter.attributes.get("type", "TBL").strip()
    if kind == "TBL":
        return _Entries(scope, child).table(parameter)
    if kind == "DD":
        return _Diagram(parameter, variables).potential()
    return parameter.fail(f"a function of type {kind!r} is neither TBL nor DD")


class _Entries:
    """Fills a table from entries; variables that are ``*`` in every entry are left out of its scope."""

    def __init__(self, scope: Sequence[Variable], child: Variable | None) -> None:
        self._scope = scope
        self._child = child

    def table(self, parameter: Element) -> Table:
        """Return the table; values without an entry are 0."""
        entries = [(entry, self._instance(entry)) for entry in parameter.all("Entry")]
        kept = [
            axis
            for axis, variable in enumerate(self._scope)
            if variable == self._child or any(words[axis] != "*" for _, words in entries)
        ]
        sizes = [len(self._scope[axis].factor) for axis in kept]
        if math.prod(sizes) > _MOST_NUMBERS:
            parameter.fail(f"a table of {math.prod(sizes)} numbers is too large; use a decision diagram (DD)")
        values = np.zeros(sizes)
        for entry, words in entries:
            self._fill(values, entry, [words[axis] for axis in kept], kept)
        return Table([self._scope[axis].node for axis in kept], values)

    def _instance(self, entry: Element) -> list[str]:
        instance = entry.need("Instance")
        words = instance.text.split()
        if len(words) != len(self._scope):
            names = " ".join(variable.factor.name for variable in self._scope)
            instance.fail(f"{len(words)} words are given, but the function is over {len(self._scope)}: {names}")
        return words

    def _fill(self, values: npt.NDArray[np.float64], entry: Element, words: list[str], kept: list[int]) -> None:
        chosen: list[int | slice] = []
        shape: list[int] = []  # of the numbers; an axis of equal values has size 1
        for word, axis in zip(words, kept, strict=True):
            if word in {"-", "*"}:
                chosen.append(slice(None))
                shape.append(len(self._scope[axis].factor) if word == "-" else 1)
            else:
                chosen.append(_value(entry.need("Instance"), self._scope[axis].factor, word))
        given = entry.find("ProbTable") or entry.find("ValueTable") or entry.need("ProbTable")
        free = [size for word, size in zip((w for w in words if w in {"-", "*"}), shape, strict=True) if word == "-"]
        values[tuple(chosen)] = self._numbers(given, words, free).reshape(shape)

    def _numbers(self, given: Element, words: list[str], free: list[int]) -> npt.NDArray[np.float64]:
        """Return an entry's numbers over the variables with ``-``; the last changes fastest."""
        text = given.text.split()
        if text == ["uniform"]:
            if self._child is None or words[-1] not in {"-", "*"}:
                given.fail("'uniform' needs a distribution, with '-' for the last variable")
            size = len(self._child.factor)
            return np.full(free, 1 / size)
        if text == ["identity"]:
            if len(free) != 2 or free[0] != free[1]:
                given.fail("'identity' needs two '-' for variables of one size")
            return np.eye(free[0])
        count = math.prod(free)
        numbers = [given.number(word) for word in text] if len(text) == count else None
        if numbers is None:
            given.fail(f"{len(text)} numbers are given, but the variables with '-' have {count} combinations of values")
        return np.array(numbers, dtype=np.float64).reshape(free)


class _Diagram:
    """Reads a decision diagram; a template is read once and shared by all references to it."""

    def __init__(self, parameter: Element, variables: Mapping[str, Variable]) -> None:
        self._parameter = parameter
        self._variables = variables
        self._templates = {template.attribute("id"): template for template in parameter.all("SubDAGTemplate")}
        self._read: dict[str, Potential] = {}

    def potential(self) -> Potential:
        return self._inside(self._parameter.need("DAG"), 0)

    def _inside(self, element: Element, depth: int) -> Potential:
        """Return the potential of an element's only child."""
        if depth > _DEPTH:
            element.fail(f"templates refer to each other more than {_DEPTH} deep")
        if len(element.children) != 1:
            element.fail(f"<{element.tag}> needs one <Node>, <Terminal> or <SubDAG>, not {len(element.children)}")
        inner = element.children[0]
        if inner.tag == "Node":
            return self._node(inner, depth + 1)
        if inner.tag == "Terminal":
            return Table([], inner.number(inner.text.strip()))
        if inner.tag == "SubDAG":
            return self._shortcut(inner, depth + 1)
        return inner.fail(f"<Node>, <Terminal> or <SubDAG> was expected, not <{inner.tag}>")

    def _node(self, element: Element, depth: int) -> Potential:
        variable = self._variable(element)
        factor = variable.factor
        branches: list[Potential] = []
        choice = [-1] * len(factor)
        for edge in element.all("Edge"):
            value = _value(edge, factor, edge.attribute("val"))
            if choice[value] >= 0:
                edge.fail(f"a second edge for {factor.names[value]!r}")
            choice[value] = len(branches)
            branches.append(self._inside(edge, depth))
        if -1 in choice:  # values without an edge are 0, as in tables
            choice = [len(branches) if branch < 0 else branch for branch in choice]
            branches.append(Table([], 0.0))
        try:
            return Tree(variable.node, choice, branches)
        except ModelError as error:
            return element.fail(str(error))

    def _shortcut(self, element: Element, depth: int) -> Potential:
        kind = element.attribute("type")
        if kind == "template":
            name = element.attribute("idref")
            if name not in self._templates:
                element.fail(f"there is no template {name!r}; there are {', '.join(self._templates) or 'none'}")
            if name not in self._read:
                self._read[name] = self._inside(self._templates[name], depth)
            return self._read[name]
        if kind not in {"uniform", "deterministic", "persistent"}:
            element.fail(
                f"a <SubDAG> has the type {kind!r}: uniform, deterministic, persistent or template was expected"
            )
        variable = self._variable(element)
        size = len(variable.factor)
        if kind == "uniform":
            return Table([variable.node], np.full(size, 1 / size))
        if kind == "deterministic":
            value = _value(element, variable.factor, element.attribute("val"))
            return Table([variable.node], np.eye(size)[value])
        if variable.node.role not in {"state", "next_state"}:
            element.fail(f"{variable.factor.name!r} is not a state variable, so 'persistent' has no previous value")
        place = variable.node.place
        return Table([Node("state", place), Node("next_state", place)], np.eye(size))

    def _variable(self, element: Element) -> Variable:
        name = element.attribute("var")
        if name not in self._variables:
            element.fail(f"there is no variable {name!r} here; there are {', '.join(self._variables)}")
        return self._variables[name]


def _value(element: Element, factor: Factor, word: str) -> int:
    try:
        return factor.index(word)
    except ModelError as error:
        return element.fail(str(error))


# -- Writing -----------------------------------------------------------------------------------------------------------

_FOREIGN = re.compile("[\\s\x00-\x1f\ud800-\udfff\ufffe\uffff]")
_MANY = 1000
_FEW = 0.3
_ELEMENTS: tuple[tuple[Role, str, str], ...] = (
    ("state", "StateVar", "s"),
    ("action", "ActionVar", "a"),
    ("observation", "ObsVar", "o"),
)
_SECTIONS: tuple[tuple[Role, str], ...] = (
    ("state", "InitialStateBelief"),
    ("next_state", "StateTransitionFunction"),
    ("observation", "ObsFunction"),
)


def write(model: MDP, path: str | Path) -> None:
    """Write a model as POMDPX; a flat model is factored by the chain rule over its spaces' factors.

    Names that are not single words are changed, with a warning. Variables get unique names. An MDP is written as a
    model whose factors are all fully observed. State factors or observations that depend on each other in ways that
    SARSOP does not read are joined into one, with a warning.

    Raises:
        ModelError: If observations are events, which POMDPX lacks, or the model is too large for tables.
        FormatError: If the file cannot be written.
    """
    network = as_network(model)
    if network.event_observations:
        raise ModelError(
            "POMDPX cannot hold observations of events, P(o | s, a, s'): write .pgmx, or an archive (.npz)"
        )
    document = _Written(_without_links(network))
    write_text(path, "\n".join(document.lines(model.discount)) + "\n")
    document.speller.warn("POMDPX")


def _without_links(network: TwoSliceNetwork) -> TwoSliceNetwork:
    """Return a network without links that SARSOP refuses."""
    free = unlinked(network, "observation")
    if free is None:
        _warn(f"the {len(network.observation)} observations depend on each other; for SARSOP they are joined into one")
        free = joined(network, "observations")
    if _has_readable_states(free):
        return free
    other = unlinked(free, "next_state")
    if other is not None:
        return other
    seen = _observed(free)
    if any(seen) and not all(seen):
        _warn("state factors depend on others of the same slice, some of them hidden: SARSOP does not read this file")
        return free
    _warn(f"the {len(seen)} state factors depend on each other; for SARSOP they are joined into one")
    return joined(free, "states")


def _warn(text: str) -> None:
    warnings.warn(text, ModelWarning, stacklevel=5)


def _observed(network: TwoSliceNetwork) -> tuple[bool, ...]:
    """Return for each state factor whether it is written as fully observed."""
    return network.fully_observed if network.observations is not None else (True,) * len(network.states.factors)


def _has_readable_states(network: TwoSliceNetwork) -> bool:
    seen = _observed(network)
    links = (
        (node.place, parent.place)
        for node in (Node("next_state", place) for place in range(len(seen)))
        for parent in network.parents(node)
        if parent.role == "next_state"
    )
    return all(seen[parent] and not seen[child] for child, parent in links)


class _Written:
    def __init__(self, network: TwoSliceNetwork) -> None:
        self._network = network
        self.speller = Speller(_FOREIGN, {"-", "*"})
        titles = Speller(_FOREIGN, {"null"})
        self._variables: dict[Node, str] = {}
        self._values: dict[Node, list[str]] = {}
        for role, _, _ in _ELEMENTS:
            for place, factor in enumerate(network.factors(role)):
                node = Node(role, place)
                self._variables[node] = titles.spell([factor.name], self._taken, numbered=False)[0]
                self._values[node] = self.speller.spell(factor.names)
        for place in range(len(network.states.factors)):
            name = unused(f"{self._variables[Node('state', place)]}'", lambda found: found in self._taken)
            self._variables[Node("next_state", place)] = name
            self._values[Node("next_state", place)] = self._values[Node("state", place)]

    @property
    def _taken(self) -> set[str]:
        return set(self._variables.values())

    def lines(self, discount: float) -> list[str]:
        network = self._network
        lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<pomdpx version="1.0" id="mdm">']
        lines += [f"<Discount>{discount!r}</Discount>", "<Variable>", *self._declarations(), "</Variable>"]
        for role, section in _SECTIONS:
            potentials = initial(network) if role == "state" else network.potentials(role)
            if not potentials:
                continue
            lines.append(f"<{section}>")
            for place, potential in enumerate(potentials):
                lines += self._function("CondProb", self._variables[Node(role, place)], potential, Node(role, place))
            lines.append(f"</{section}>")
        lines.append("<RewardFunction>")
        for index, utility in enumerate(utilities(network)):
            lines += self._function("Func", self._reward(index), utility, None)
        return [*lines, "</RewardFunction>", "</pomdpx>"]

    def _reward(self, index: int) -> str:
        return unused(f"reward{index}", lambda found: found in self._taken)

    def _declarations(self) -> list[str]:
        lines = []
        observed = _observed(self._network)
        for role, tag, prefix in _ELEMENTS:
            for place in range(len(self._network.factors(role))):
                node = Node(role, place)
                values = self._values[node]
                name = quoted(self._variables[node])
                if role == "state":
                    after = quoted(self._variables[Node("next_state", place)])
                    seen = "true" if observed[place] else "false"
                    begin = f'<{tag} vnamePrev={name} vnameCurr={after} fullyObs="{seen}">'
                else:
                    begin = f"<{tag} vname={name}>"
                counted = values == [f"{prefix}{index}" for index in range(len(values))]
                listed = f"<ValueEnum>{escape(' '.join(values))}</ValueEnum>"
                lines.append(begin + (f"<NumValues>{len(values)}</NumValues>" if counted else listed) + f"</{tag}>")
        lines += [f"<RewardVar vname={quoted(self._reward(index))}/>" for index in range(len(utilities(self._network)))]
        return lines

    def _function(self, tag: str, variable: str, potential: Potential, child: Node | None) -> list[str]:
        parents = [node for node in potential.scope if node != child]
        if child is not None and child.role == "next_state":
            # SARSOP multiplies these tables, and fails where none of them has an action or the state before.
            actions = [Node("action", place) for place in range(len(self._network.actions.factors))]
            parents += [node for node in (*actions, Node("state", child.place)) if node not in parents]
        elif not parents and (child is None or child.role != "state"):
            parents = [Node("action", 0)]  # only what is initial depends on nothing
        names = " ".join(self._variables[node] for node in parents) or "null"
        head = f"<{tag}><Var>{escape(variable)}</Var><Parent>{escape(names)}</Parent>"
        order = parents if child is None else [*parents, child]
        if _count_leaves(potential, {}) > math.prod(len(self._values[node]) for node in order):
            potential = tabulated(potential)
        entries = [
            line for fixed, table in _leaves(potential, {}) for line in self._entries(table, fixed, order, child)
        ]
        return [head, '<Parameter type="TBL">', *entries, f"</Parameter></{tag}>"]

    def _entries(self, table: Table, fixed: dict[Node, int], order: list[Node], child: Node | None) -> list[str]:
        """Return the entries of a table where some variables are fixed: one, or one for each number that is not 0."""
        at = tuple(fixed.get(node, slice(None)) for node in table.scope)
        scope = [node for node in table.scope if node not in fixed]
        values = table.values[at]
        if child is not None and child not in fixed and child not in scope:
            values = np.broadcast_to(values[..., None], (*values.shape, len(self._values[child])))
            scope.append(child)
        spread = [node for node in order if node in scope]
        values = values.transpose([scope.index(node) for node in spread])
        tag = "ValueTable" if child is None else "ProbTable"
        instance = [
            escape(self._values[node][fixed[node]]) if node in fixed else "-" if node in scope else "*"
            for node in order
        ]
        few = values.size > _MANY and np.count_nonzero(values) < _FEW * values.size
        if not few or (child is not None and child.role == "state"):
            numbers = " ".join(map(repr, values.ravel().tolist()))
            return [f"<Entry><Instance>{' '.join(instance)}</Instance><{tag}>{numbers}</{tag}></Entry>"]
        places = np.nonzero(values)
        columns = [
            np.array([escape(value) for value in self._values[node]], dtype=object)[places[spread.index(node)]]
            if node in spread
            else [word] * len(places[0])
            for node, word in zip(order, instance, strict=True)
        ]
        return [
            f"<Entry><Instance>{' '.join(words)}</Instance><{tag}>{number!r}</{tag}></Entry>"
            for *words, number in zip(*columns, values[places].tolist(), strict=True)
        ]


def _leaves(potential: Potential, fixed: dict[Node, int]) -> Iterator[tuple[dict[Node, int], Table]]:
    """Yield the tables at the ends of a tree, and the values of variables that lead to them."""
    if isinstance(potential, Table):
        yield fixed, potential
        return
    for value, choice in enumerate(potential.choice.tolist()):
        if fixed.get(potential.node, value) == value:
            yield from _leaves(potential.branches[choice], {**fixed, potential.node: value})


def _count_leaves(potential: Potential, done: dict[int, int]) -> int:
    """Return the number of paths through a tree."""
    if isinstance(potential, Table):
        return 1
    if id(potential) not in done:
        done[id(potential)] = sum(_count_leaves(potential.branches[choice], done) for choice in potential.choice)
    return done[id(potential)]
