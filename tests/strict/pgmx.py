"""A strict reader of ProbModelXML, as MADP reads it.

No variable's name begins with that of another; a name may end with its slice, as `` [1]``, which is cut wherever a name
ends with a bracket, two characters before it: none else does. Names of variables stand within quotes of both kinds, and
have none; an observation with a slice has two letters at least, for a blank after one letter stays. The first start of
a variable that begins with a factor's name, without its slice, is the factor's, and no label is within another.

No observation is linked to another, and no initial value; there is one where it is of events. The first variable of a
table changes fastest. A utility has variables; where one of them is at slice 1, so are its parents that are there among
them.
"""

from __future__ import annotations

import itertools
import math
import re
import string
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from strict.numbers import Numbers, need, number, sums

PRECISION, LATER = 5e-13, 1e-4
Key = tuple[str, int]


def read(path) -> Numbers:
    """Read a model; its discount is None."""
    return _Reader(ET.parse(path).getroot()).numbers()


def key(element) -> Key:
    """Return a variable's name and slice."""
    need(element.get("timeSlice") in {"0", "1"}, "a time slice")
    return element.get("name"), int(element.get("timeSlice"))


def plain(name: str) -> str:
    """Return a variable's name without its slice."""
    return re.sub(r" \[[01]\]$", "", name)


class _Reader:
    def __init__(self, root) -> None:
        need(root.tag == "ProbModelXML" and [part.tag for part in root] == ["ProbNet"], "the root")
        (net,) = root
        properties = {one.get("name"): one.get("value") for one in net.findall("AdditionalProperties/Property")}
        self.events = properties.get("EventDriven", "0") != "0"
        self.agents = [agent.get("name") for agent in net.findall("Agents/Agent")]
        need(len(set(self.agents)) == len(self.agents), "agents")
        self.variables: dict[Key, list[str]] = {}
        self.roles: dict[Key, str] = {}
        self.owners: dict[Key, str] = {}
        for variable in net.findall("Variables/Variable"):
            place = key(variable)
            need(place not in self.variables, f"{place} is declared twice")
            names = [state.get("name") for state in variable.findall("States/State")]
            need(len(set(names)) == len(names), f"the states of {place}")
            need(not any(name.endswith("]") for name in (*names, plain(place[0]))), f"{place} or a state ends with ']'")
            need(not {'"', "'"} & set(place[0]), f"a quote in {place}")
            self.variables[place], self.roles[place] = names, variable.get("role")
            need(self.roles[place] in {"chance", "decision", "utility"}, "a role")
            need((self.roles[place] == "utility") == (not names), f"the states of {place}")
            agent = variable.find("Agent")
            if agent is not None:
                need(agent.get("name") in self.agents, "an unknown agent")
                self.owners[place] = agent.get("name")
        names = sorted({name for name, _ in self.variables})
        for one, other in itertools.pairwise(names):  # a name sorts before the first that it begins
            need(one and one == one.strip() and not other.startswith(one), f"{other!r} begins with {one!r}")
        self.links = []
        for link in net.findall("Links/Link"):
            parent, child = (key(end) for end in link)
            need(parent in self.variables and child in self.variables, "a link of what is not declared")
            self.links.append((parent, child))
        self.potentials: dict[Key, Any] = {}
        for potential in net.findall("Potentials/Potential"):
            of = potential.find("UtilityVariable")
            of = potential.find("Variables")[0] if of is None else of
            need(key(of) in self.variables and key(of) not in self.potentials, f"a potential of {key(of)}")
            self.potentials[key(of)] = potential

    def ordered(self, role: str, time: int) -> list[Key]:
        found = [place for place in self.variables if self.roles[place] == role and place[1] == time]
        if role == "decision" and not self.events and len(found) == len(self.agents) > 1:
            found.sort(key=lambda place: self.agents.index(self.owners[place]))
        return found

    def numbers(self) -> Numbers:
        states = [place for place in self.ordered("chance", 0) if len(self.variables[place]) > 1]
        later = [(re.sub(r" \[0\]$", " [1]", name), 1) for name, _ in states]
        actions = self.ordered("decision", 0)
        seen = []
        need(len(self.ordered("decision", 1)) <= len(actions), "a decision without its first slice")
        for decision in self.ordered("decision", 1):
            parents = [p for p, child in self.links if child == decision and self.roles[p] == "chance" and p[1] == 1]
            need(len(parents) == 1, f"the observation of {decision}")
            seen += parents
        need(len(set(seen)) == len(seen) and not set(seen) & set(later), "an observation of its own each")
        need(len(seen) <= 1 or not self.events, "several observations of events")
        need(all(len(name) != 5 or name == plain(name) for name, _ in seen), "a blank after one letter")
        for name, _ in states:
            first = next(other for other in self.potentials if other in states and other[0].startswith(plain(name)))
            need(first[0] == name, f"the start of {first} is taken for that of {name!r}")
        for alike in (seen, states):
            need(not any({parent, child} <= set(alike) for parent, child in self.links), f"a link among {alike}")
        size, count, width = (self.size(each) for each in (states, actions, seen))
        start = self.product(states, states).reshape(size)
        transitions = self.product(later, [*actions, *states, *later]).reshape(count, size, size)
        observations = None
        if seen:
            before = states if self.events else []
            observations = self.product(seen, [*actions, *before, *later, *seen])
            observations = observations.reshape(count, size if self.events else 1, size, width)
            if not self.events:
                sums(observations, LATER, "O")
        sums(start, PRECISION, "the start")
        sums(transitions, LATER, "T")
        utilities = self.ordered("utility", 0)
        need(utilities, "no rewards")
        scopes = [self.scope(self.potentials[place]) for place in utilities]
        outcomes = not {*later, *seen}.isdisjoint(place for scope in scopes for place in scope)
        told = not set(seen).isdisjoint(place for scope in scopes for place in scope)
        axes = [*actions, *states, *(later if outcomes else []), *(seen if told else [])]
        for scope in scopes:
            need(scope, "a utility of no variable")
            beside = {
                parent for parent, child in self.links if child in set(scope) & {*later, *seen} and parent[1] == 1
            }
            need(beside <= set(scope), f"a utility without {beside - set(scope)}")
        rewards: Any = 0
        for place in utilities:
            rewards = rewards + self.function(self.potentials[place], axes)
        full = np.broadcast_to(rewards, [len(self.variables[place]) for place in axes])
        shape = (count, size, size if outcomes else 1, width if told else 1)
        return Numbers(None, start, transitions, observations, full.reshape(shape), told)

    def size(self, places: list[Key]) -> int:
        return math.prod(len(self.variables[place]) for place in places)

    def product(self, places: list[Key], axes: list[Key]) -> Any:
        result: Any = 1.0
        for place in places:
            need(place in self.potentials, f"{place} has no potential")
            scope = self.scope(self.potentials[place])
            parents = {parent for parent, child in self.links if child == place}
            need(set(scope) - {place} <= parents, f"{place} depends on what it is not linked to")
            result = result * self.function(self.potentials[place], axes)
        return np.broadcast_to(result, [len(self.variables[place]) for place in axes])

    def scope(self, potential) -> list[Key]:
        found = [key(variable) for variable in potential.findall("Variables/Variable")]
        need(len(set(found)) == len(found) and set(found) <= set(self.variables), "the variables of a potential")
        return found

    def function(self, potential, axes: list[Key]) -> Any:
        """Return a potential as an array with the given axes, of length 1 where it does not depend on one."""
        scope = self.scope(potential)
        need(set(scope) <= set(axes), f"{set(scope) - set(axes)} is out of place")
        labels = {}
        for branch in potential.iter("Branch"):
            if branch.find("Label") is not None:
                need(branch.find("Label").text not in labels, "two branches have one label")
                labels[branch.find("Label").text] = branch
        for one, other in itertools.permutations(labels, 2):
            need(one not in other, f"the label {one!r} is within {other!r}")
        array = self.values(potential, scope, labels)
        letters = dict(zip(axes, string.ascii_letters, strict=False))
        kept = [place for place in axes if place in scope]
        pattern = "".join(letters[p] for p in scope) + "->" + "".join(letters[p] for p in kept)
        array = np.einsum(pattern, array)
        return array.reshape([len(self.variables[place]) if place in scope else 1 for place in axes])

    def values(self, potential, scope: list[Key], labels) -> Any:
        """Return a potential's numbers over a scope."""
        mine = self.scope(potential)
        need(set(mine) <= set(scope), "a branch depends on more than its tree")
        sizes = [len(self.variables[place]) for place in scope]
        kind = potential.get("type")
        if kind == "Table":
            told = [number(word) for word in potential.find("Values").text.split()]
            own = [len(self.variables[place]) for place in mine]
            need(len(told) in {1, math.prod(own)}, f"{len(told)} numbers for {own}")
            array = np.full(own, told[0]) if len(told) == 1 else np.array(told).reshape(own[::-1]).T
            order = [mine.index(place) for place in scope if place in mine]
            shape = [len(self.variables[place]) if place in mine else 1 for place in scope]
            return np.broadcast_to(array.transpose(order).reshape(shape), sizes)
        need(kind == "Tree/ADD", f"a potential of type {kind}")
        top = key(potential.find("TopVariable"))
        need(top in mine, "the variable on top")
        result = np.full(sizes, np.nan)
        axis = scope.index(top)
        names = self.variables[top]
        for branch in potential.find("Branches"):
            inner = branch.find("Potential")
            if inner is None:
                need(branch.find("Reference").text in labels, "an unknown label")
                inner = labels[branch.find("Reference").text].find("Potential")
            array = self.values(inner, scope, labels)
            for state in branch.find("States"):
                place = (slice(None),) * axis + (names.index(state.get("name")),)
                need(np.isnan(result[place]).all(), f"two branches for {state.get('name')}")
                result[place] = array[place]
        need(not np.isnan(result).any(), "a tree without a branch for each value")
        return result
