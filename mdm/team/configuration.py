"""The configuration of an agent: the facts that must be the same at every agent of a team, and their one comparison.

A fact is a name and its value here, in words. Facts that one can read come first, then hashes of long ones.
Beats carry the facts of the team and a hash for each ensemble; only where that differs, the facts behind it are asked
for. Every other comparison is asked of `Configuration`, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import msgspec

from mdm.models.digest import digest, of_parts
from mdm.version import __version__

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mdm.actors import Ensemble
    from mdm.controller import Controller
    from mdm.team.ownership import Ownership
    from mdm.team.team import Team

ANY = ""
"""The value of a fact at an agent that it does not concern: no difference to anything."""

_SAFE_ACTION = "safe_action"
"""The one fact that is no matter of an agent's own where it does not act."""

_MANY = 8
_HASH = 12

Standing: TypeAlias = tuple[bool, int]
"""Whether an agent has been in the team for some time, and how many agents are live for it: the greater one stays."""


class Configuration:
    """The configuration of one agent, and which other agents have another one.

    Of two agents that differ, one is refused: that which came later, or has less company, or else the later one by
    name. Each of them comes to the same result by the other's beats.

    Args:
        agent: This agent.
        facts: Facts by name, which must be the same at all agents that have them.

    Attributes:
        facts: The same, with a hash for each ensemble: the facts in beats.
        differing: The agents of another configuration, with the incarnation that has it.
        last_refusal: Why this agent was refused last.
    """

    def __init__(self, agent: str, facts: Mapping[str, str]) -> None:
        self.agent = agent
        self.facts = dict(facts)
        self.differing: dict[str, int] = {}
        self.last_refusal: str | None = None
        self._ensembles: dict[str, Mapping[str, str]] = {}
        self._ensemble_of: dict[str, str] = {}
        self._outranking: dict[str, str] = {}
        self._heard_at: dict[str, int] = {}

    def add(self, ensemble: str, facts: Mapping[str, str]) -> None:
        """Compare an ensemble, too."""
        self._ensembles[ensemble] = facts
        told = brief(ensemble, facts)
        self.facts |= told
        self._ensemble_of |= dict.fromkeys(told, ensemble)

    def token(self, ensemble: str) -> str:
        """Return a hash of the facts of an ensemble; agents that differ have another one."""
        return of_parts([msgspec.msgpack.encode(sorted(self._ensembles[ensemble].items()))])[:16]

    @property
    def refusal(self) -> str | None:
        """Why this agent takes no part in the team now; None where it does."""
        return next(iter(self._outranking.values()), None)

    def refuses(self, other: str) -> bool:
        """Return whether it is this agent that is refused, where another differs from it."""
        return other in self._outranking

    def difference(self, other: str, facts: Mapping[str, str]) -> str | None:
        """Return in words the first fact of a beat that is another there; None where all shared ones are the same."""
        if facts == self.facts:
            return None
        shared = [fact for fact in self.facts if fact in facts]
        here, theirs = ({fact: one[fact] for fact in shared} for one in (self.facts, facts))
        return self._in_words(other, here, theirs)

    def ensemble(self, facts: Mapping[str, str]) -> str | None:
        """Return the ensemble whose hash is the first fact of a beat that is another here, if one is."""
        first = next((fact for fact, here in self.facts.items() if facts.get(fact, here) != here), None)
        return self._ensemble_of.get(first or "")

    def explain(self, other: str, ensemble: str, facts: Mapping[str, str]) -> str | None:
        """Return in words the first fact of an ensemble that is another there."""
        return self._in_words(other, self._ensembles[ensemble], facts)

    def _in_words(self, other: str, here: Mapping[str, str], theirs: Mapping[str, str]) -> str | None:
        """Return the first difference, with the agent that is refused first."""
        if other in self.differing and other not in self._outranking:
            return difference(theirs, other, here, self.agent)
        return difference(here, self.agent, theirs, other)

    def part(self, other: str, life: int, told: str, own: Standing, theirs: Standing, now: int) -> bool:
        """Take note of another agent that differs; return whether that is new. Their standing says who is refused."""
        if self.differing.get(other) != life:
            self.agree(other)
        self._heard_at[other] = now
        if other in self.differing:
            return False
        self.differing[other] = life
        if theirs > own or (theirs == own and other < self.agent):
            self.refuse(other, told)
        return True

    def refuse(self, other: str, told: str) -> None:
        """Refuse this agent, because of a difference to another."""
        self._outranking[other] = self.last_refusal = told

    def agree(self, other: str) -> bool:
        """Forget that another agent has another configuration: it agrees, or is gone; return whether it had one."""
        if self.differing.pop(other, None) is None:
            return False
        del self._heard_at[other]
        self._outranking.pop(other, None)
        return True

    def expire(self, before: int) -> bool:
        """Forget agents that were last heard to differ before a time; return whether there are any."""
        gone = [other for other, heard in self._heard_at.items() if heard < before]
        for other in gone:
            self.agree(other)
        return bool(gone)


def difference(here: Mapping[str, str], agent: str, theirs: Mapping[str, str], there: str) -> str | None:
    """Return in words the first fact of `here`, at an agent, that is another there; None if there is none."""
    for fact in dict.fromkeys((*here, *theirs)):
        one, other = here.get(fact), theirs.get(fact)
        if one != other and ANY not in {one, other}:
            return f"{fact} is {one} at {agent} and {other} at {there}"
    return None


def brief(ensemble: str, facts: Mapping[str, str]) -> dict[str, str]:
    """Return the facts of an ensemble in few bytes: one hash of those that each agent has, and the other one."""
    every = sorted((fact, value) for fact, value in facts.items() if fact != _SAFE_ACTION)
    told = {f"configuration of ensemble {ensemble!r}": of_parts([repr(every).encode()])[:_HASH]}
    if facts.get(_SAFE_ACTION, ANY) != ANY:
        told[f"safe_action of ensemble {ensemble!r}"] = facts[_SAFE_ACTION]
    return told


def facts(team: Team, ensemble: Ensemble, ownership: Ownership, start: bytes, protocol: int) -> dict[str, str]:
    """Return the facts of an ensemble, by name, which must be the same at every agent of a team."""
    controller, own_deadline = ensemble.controller, ensemble.status().deadline
    return {
        "program's version": __version__ if protocol == 1 else f"{__version__}, protocol {protocol}",
        "team's drive": "events" if team.period is None else f"a period of {team.period:g} s",
        "team's deadline": f"{team.deadline:g} s",
        "team's lease": f"{team.lease:g} s",
        "team's quorum": team.quorum,
        "team's max_age": f"{team.max_age:g} s",
        **_words(controller),
        **ownership.facts(),
        "horizon": str(controller.horizon),
        "on_impossible": controller.on_impossible,
        "deadline": "none" if own_deadline is None else f"{own_deadline:g} s",
        _SAFE_ACTION: ANY if ensemble.action.idle else _safe_action(ensemble),
        "on_lost_teammate": ensemble.safety.on_lost_teammate or "continue",
        "memory": "limited" if getattr(controller.model, "is_sparing", False) else "not limited",
        "initial belief": _belief(controller),
        "hash of the model": "none" if controller.model is None else digest(controller.model)[:_HASH],
        "hash of the policy": of_parts(getattr(controller.policy, "parameters", list)())[:_HASH],
        "hash of the policy, the rewards and the options": controller.configuration[:_HASH],
        "hash of the beginning, by the initial belief and the seed": of_parts([start])[:_HASH],
    }


def _words(controller: Controller) -> dict[str, str]:
    """Return a description of the model and the policy, and the policy's value at its beginning."""
    model, policy = controller.model, controller.policy
    told = {"model": "none", "policy": _sizes(type(policy).__name__, getattr(policy, "facts", dict)())}
    if model is not None:
        spaces = {"states": model.state_space, "actions": model.action_space}
        if (observations := getattr(model, "observation_space", None)) is not None:
            spaces["observations"] = observations
        sizes = {name: len(space) for name, space in spaces.items()}
        told["model"] = f"{_sizes(type(model).__name__, sizes)}, discounted by {model.discount:g}"
    if controller.belief is not None and hasattr(policy, "value_at") and not getattr(policy, "deliberates", False):
        value = policy.value_at(controller.belief)
        told["policy's value of the initial belief"] = "none" if value is None else f"{value:.9g}"
    return told


def _sizes(name: str, sizes: Mapping[str, object]) -> str:
    listed = [f"{count} {kind}" for kind, count in sizes.items() if count is not None]
    return f"{name} of {', '.join(listed)}" if listed else name


def _belief(controller: Controller) -> str:
    belief = controller.belief
    if belief is None:
        return "none"
    return of_parts([belief])[:_HASH] if len(belief) > _MANY else ", ".join(f"{chance:.6g}" for chance in belief)


def _safe_action(ensemble: Ensemble) -> str:
    """Return the name of the safe action, where it is one that all agents of the model have."""
    action, space = ensemble.action, ensemble.controller.symbols.action_space
    if action.safe is None:
        return "none"
    if action.safe not in action.bindings or space is None:
        return "a function"
    name = action.names[action.bindings.index(action.safe)]
    return repr(name) if all(name in factor.names for factor in space.factors) else "an action of the agent's own"
