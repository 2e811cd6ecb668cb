"""POMDPX, the format of APPL's SARSOP: factored POMDPs with mixed observability.

See https://bigbird.comp.nus.edu.sg/pmwiki/farm/appl/index.php?n=Main.PomdpXDocumentation.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from mdm.errors import ModelError, ModelWarning
from mdm.formats.markup import Element, stream
from mdm.formats.pomdpx.functions import Variable, function
from mdm.formats.pomdpx.writer import write
from mdm.formats.source import Source, number
from mdm.models import Factor, FactoredMDP, FactoredPOMDP, Space
from mdm.models.factored.potential import Node, Potential, Role, Table
from mdm.models.factored.two_slice import PotentialError, TwoSliceNetwork

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["read", "write"]

_WHOLE = {"Description", "Discount", "Variable", "CondProb", "Func"}
_SECTIONS: dict[str, Role] = {
    "InitialStateBelief": "state",
    "StateTransitionFunction": "next_state",
    "ObsFunction": "observation",
}
_LARGEST = 1_000_000


def read(path: str | Path, *, sparse: bool | None = None) -> FactoredMDP | FactoredPOMDP:
    """Read a factored model; without observation variables and with every factor fully observed, an MDP.

    Args:
        path: The file.
        sparse: Force CSR (True) or dense (False) matrices when it is flattened; None chooses.

    Raises:
        FormatError: If the file is malformed, with the place and what was expected.
    """
    document = _Document(Source(path))
    try:
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
            elif element.tag == "CondProb" and section in _SECTIONS:
                self._read_distribution(element, _SECTIONS[section])
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
                self._add_state(variable)
            elif variable.tag == "ActionVar":
                self._add(variable, "vname", "action", "a")
            elif variable.tag == "ObsVar":
                self._add(variable, "vname", "observation", "o")
            elif variable.tag == "RewardVar":
                self._rewards.add(variable.attribute("vname"))
            else:
                variable.fail(f"StateVar, ActionVar, ObsVar or RewardVar was expected, not <{variable.tag}>")

    def _add_state(self, element: Element) -> None:
        seen = element.attributes.get("fullyObs", "false").strip().lower()
        if seen not in {"true", "false", "0", "1"}:
            element.fail(f"fullyObs is true or false, not {seen!r}")
        factor = self._add(element, "vnamePrev", "state", "s")
        self._fully_observed.append(seen in {"true", "1"})
        name = element.attribute("vnameCurr")
        self._name(element, name, Variable(Node("next_state", len(self._fully_observed) - 1), factor))

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
        section = next(name for name, of in _SECTIONS.items() if of == role)
        for place, factor in enumerate(factors):
            if Node(role, place) not in self._potentials:
                self.source.fail(f"<{section}> has no <CondProb> for {factor.name!r}")
        return [self._potentials[Node(role, place)] for place in range(len(factors))]
