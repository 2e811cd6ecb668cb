"""A strict reader of POMDPX, as SARSOP reads it.

Every variable has one function, a table. A fully observed factor depends on no other of its slice, a hidden one on
fully observed ones alone; an observation depends on actions and next states. Names are single words.
"""

from __future__ import annotations

import math
import string
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from strict.numbers import Numbers, need, number, sums

PRECISION = 1e-9


def read(path) -> Numbers:
    """Read a model."""
    return _Reader(ET.parse(path).getroot()).numbers()


class _Reader:
    def __init__(self, root) -> None:
        need(root.tag == "pomdpx", "the root")
        expected = ["Discount", "Variable", "InitialStateBelief", "StateTransitionFunction", "ObsFunction"]
        order = [*expected, "RewardFunction"]
        parts = [part.tag for part in root]
        need(parts == [tag for tag in order if tag in parts] and "Discount" in parts, f"sections {parts}")
        self.parts = {part.tag: part for part in root}
        self.values: dict[str, list[str]] = {}
        self.observed: set[str] = set()
        self.kinds: dict[str, list[str]] = {kind: [] for kind in ("prev", "curr", "action", "obs", "reward")}
        for variable in self.parts["Variable"]:
            if variable.tag == "StateVar":
                need(variable.get("fullyObs") in {"true", "false"}, "fullyObs")
                if variable.get("fullyObs") == "true":
                    self.observed.add(variable.get("vnameCurr"))
                self.declare("prev", variable.get("vnamePrev"), variable, "s")
                self.declare("curr", variable.get("vnameCurr"), variable, "s")
            elif variable.tag == "RewardVar":
                self.kinds["reward"].append(variable.get("vname"))
            else:
                need(variable.tag in {"ActionVar", "ObsVar"}, variable.tag)
                kind = "action" if variable.tag == "ActionVar" else "obs"
                self.declare(kind, variable.get("vname"), variable, kind[0])
        names = [name for kind in self.kinds.values() for name in kind]
        need(len(set(names)) == len(names), "two variables have one name")
        for name in names:
            need(name and name == "".join(name.split()) and name != "null", f"{name!r} is no name")

    def declare(self, kind: str, name: str, variable, prefix: str) -> None:
        (listed,) = variable
        if listed.tag == "NumValues":
            values = [f"{prefix}{index}" for index in range(int(listed.text))]
        else:
            need(listed.tag == "ValueEnum", listed.tag)
            values = listed.text.split()
        need(values and len(set(values)) == len(values), f"the values of {name}")
        need(not {"-", "*"} & set(values), "a value that stands for others")
        self.kinds[kind].append(name)
        self.values[name] = values

    def sizes(self, kind: str) -> list[int]:
        return [len(self.values[name]) for name in self.kinds[kind]]

    def numbers(self) -> Numbers:
        prev, curr, action, obs = (self.kinds[kind] for kind in ("prev", "curr", "action", "obs"))
        before, acts, seen = (math.prod(self.sizes(kind)) for kind in ("prev", "action", "obs"))
        start = self.product("InitialStateBelief", prev, [prev]).reshape(before)
        transitions = self.product("StateTransitionFunction", curr, [action, prev, curr])
        transitions = transitions.reshape(acts, before, before)
        observations = None
        if obs:
            observations = self.product("ObsFunction", obs, [action, curr, obs]).reshape(acts, 1, before, seen)
        rewards: Any = 0
        told = self.parts["RewardFunction"]
        need([function.find("Var").text.strip() for function in told] == self.kinds["reward"], "a reward each")
        everything = [*action, *prev, *curr, *obs]
        used = {name for function in told for name in function.find("Parent").text.split()}
        later = not used.isdisjoint([*curr, *obs])
        need(len(told), "no rewards")
        axes = everything if later else [*action, *prev]
        for function in told:
            rewards = rewards + self.function(function, axes, None)
        shape = (acts, before, before, seen if obs else 1) if later else (acts, before, 1, 1)
        full = np.broadcast_to(rewards, [len(self.values[name]) for name in axes])
        sums(start, PRECISION, "the start")
        sums(transitions, PRECISION, "T")
        if obs:
            sums(observations, PRECISION, "O")
        return Numbers(number(self.parts["Discount"].text), start, transitions, observations, full.reshape(shape))

    def product(self, section: str, variables: list[str], groups: list[list[str]]) -> Any:
        """Return the product of a section's functions, an axis per variable of the groups."""
        axes = [name for group in groups for name in group]
        functions = {function.find("Var").text.strip(): function for function in self.parts[section]}
        need(len(functions) == len(self.parts[section]) and set(functions) == set(variables), f"functions of {section}")
        result: Any = 1.0
        for name, function in functions.items():
            need(function.tag == "CondProb", function.tag)
            parents = function.find("Parent").text.split()
            if section == "ObsFunction":
                need(
                    parents == ["null"] or set(parents) <= {*self.kinds["action"], *self.kinds["curr"]},
                    f"the parents of {name}",
                )
            need((parents == ["null"]) <= (section == "InitialStateBelief"), f"the parents of {name}")
            if section == "StateTransitionFunction":
                before = self.kinds["prev"][variables.index(name)]
                need({*self.kinds["action"], before} <= set(parents), f"all actions and the value before of {name}")
                same = set(parents) & set(variables)
                need(not same or (name not in self.observed and same <= self.observed), f"the parents of {name}")
            if section == "InitialStateBelief" and parents == ["null"]:
                instances = [instance.text for instance in function.iter("Instance")]
                need(instances == ["-"], "the whole of a belief")
            result = result * self.function(function, axes, name)
        return np.broadcast_to(result, [len(self.values[name]) for name in axes])

    def function(self, element, axes: list[str], variable: str | None) -> Any:
        """Return a function as an array with the given axes, of length 1 where it does not depend on one."""
        need([child.tag for child in element] == ["Var", "Parent", "Parameter"], "the parts of a function")
        parents = element.find("Parent").text.split()
        need(variable is not None or parents != ["null"], "a reward of nothing")
        parents = [] if parents == ["null"] else parents
        scope = parents if variable is None else [*parents, variable]
        need(len(set(scope)) == len(scope) and set(scope) <= set(axes), f"the parents {parents}")
        parameter = element.find("Parameter")
        need(parameter.get("type", "TBL") == "TBL", "no table")
        need(scope, "a function of nothing")
        array = self.table(parameter, scope, variable)
        letters = dict(zip(axes, string.ascii_letters, strict=False))
        kept = [name for name in axes if name in scope]
        pattern = "".join(letters[n] for n in scope) + "->" + "".join(letters[n] for n in kept)
        array = np.einsum(pattern, array)
        return array.reshape([len(self.values[name]) if name in scope else 1 for name in axes])

    def table(self, parameter, scope: list[str], variable: str | None) -> Any:
        array = np.full([len(self.values[name]) for name in scope], 0.0)
        for entry in parameter:
            need(
                [child.tag for child in entry] == ["Instance", "ValueTable" if variable is None else "ProbTable"],
                "tags",
            )
            words = (entry[0].text or "").split()
            need(len(words) == len(scope), f"an instance of {len(words)} words for {scope}")
            places: list[Any] = []
            shape = []
            for word, name in zip(words, scope, strict=True):
                if word in {"*", "-"}:
                    places.append(slice(None))
                    shape.append(1 if word == "*" else len(self.values[name]))
                else:
                    need(word in self.values[name], f"{word!r} is no value of {name}")
                    places.append(self.values[name].index(word))
            told = entry[1].text.split()
            if told == ["uniform"]:
                need(words[-1] == "-", "uniform over nothing")
                array[tuple(places)] = 1 / shape[-1]
            else:
                need(len(told) == math.prod(shape), f"{len(told)} numbers for {shape}")
                array[tuple(places)] = np.array([number(word) for word in told]).reshape(shape)
        return array
