"""OpenMarkov's ProbModelXML format (``.pgmx``), interpreted as MADP does.

Chance variables at time slice 0 are state factors, decisions there are actions, and chance variables linked to a
decision at slice 1 are observations. Potentials are tables (the first variable changes fastest), uniform, or trees. The
format has no discount: it is 1, or the network's property ``Discount``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError
from mdm.formats.markup import Element, stream
from mdm.formats.pgmx.potentials import Potentials, Variable, names_of, reference
from mdm.formats.pgmx.writer import write
from mdm.formats.source import Source, number
from mdm.models import Factor, FactoredMDP, FactoredPOMDP, Space
from mdm.models.factored.potential import Node, Potential, Table
from mdm.models.factored.two_slice import PotentialError, TwoSliceNetwork

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["read", "write"]

_WHOLE = {"Variable", "Links", "Agents", "Potential", "AdditionalProperties", "Policies", "Comment", "Constraints"}


def read(path: str | Path, *, sparse: bool | None = None) -> FactoredMDP | FactoredPOMDP:
    """Read a factored model.

    Args:
        path: The file.
        sparse: Force CSR (True) or dense (False) matrices when it is flattened; None chooses.

    Raises:
        FormatError: If the file is malformed, with the place and what was expected.
    """
    source = Source(path)
    document = _Document(source)
    try:
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
        potentials = Potentials(self._variable, nodes)
        return TwoSliceNetwork(
            Space(Factor(variable.name, variable.names) for variable in factors),
            Space(Factor(variable.name, variable.names) for variable in decisions),
            Space(Factor(variable.name, variable.names) for variable in seen) if seen else None,
            initial=[self._initial(variable, Node("state", i), potentials) for i, variable in enumerate(factors)],
            transitions=[self._conditional((variable.name, 1), potentials) for variable in factors],
            observation=[self._observation(variable, index, nodes, potentials) for index, variable in enumerate(seen)],
            utilities=[
                potentials.utility(self._elements[variable.key])
                for time in (0, 1)
                for variable in self._with_role("utility", time)
                if self._need(variable.key)
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

    def _initial(self, variable: Variable, node: Node, potentials: Potentials) -> Potential:
        element = self._elements.get(variable.key)
        if element is None:
            return Table([node], np.full(len(variable.names), 1 / len(variable.names)))
        return potentials.conditional(element, variable)

    def _conditional(self, key: tuple[str, int], potentials: Potentials) -> Potential:
        self._need(key)
        return potentials.conditional(self._elements[key], self._variables[key])

    def _observation(
        self, variable: Variable, index: int, nodes: dict[tuple[str, int], Node], potentials: Potentials
    ) -> Potential:
        node = nodes[variable.key]
        if node == Node("observation", index):
            return self._conditional(variable.key, potentials)
        # A directly observed state factor, or an observation shared with another agent.
        return Table([node, Node("observation", index)], np.eye(len(variable.names)))

    def _need(self, key: tuple[str, int]) -> bool:
        if key not in self._elements:
            self.source.fail(f"variable {key[0]!r} of time slice {key[1]} has no potential")
        return True
