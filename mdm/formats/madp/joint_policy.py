"""MADP's joint policies for Dec-POMDPs, as its planners print them: an action per agent and observation history.

After ``Policy for agent 0 (index 29):`` comes a line per history of that agent's observations, shortest first, such
as ``(hear-left,hear-right) --> listen``; earlier versions wrote ``Oempty, hear-left, hear-right,  --> listen``. Text
before the agents (``JointPolicyPureVector:``) and after them (graphs, values) is skipped.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from mdm.errors import ModelError
from mdm.formats.source import Source
from mdm.formats.target import write_text
from mdm.policies import FiniteStateController, JointController

if TYPE_CHECKING:
    from pathlib import Path

    from mdm.models import MDP, Factor

_INDICES = 1 << 64
"""MADP numbers policies, the action after the first history being the most significant digit, in 64 bits."""
_AGENT = re.compile(r"Policy for agent (\d{1,9}) \(index .*\):")
_LINE = re.compile(r"(.*?) ?-->(.*)")
_NAME = re.compile(r"(?!Oempty$)(?!.*-->)[^\s,()]([^\n\r,()]*[^\s,()])?")


def read(path: str | Path, model: MDP | None) -> JointController:
    """Read a joint policy: per agent a tree with a node for each history.

    Args:
        path: The file.
        model: The policy's model, needed for its names of actions and observations.

    Raises:
        FormatError: If the model is missing, or the file is malformed, with the line and the expected form.
    """
    source = Source(path)
    if model is None or model.observation_space is None:
        source.fail("a joint policy refers to actions and observations by name: give its POMDP (--model)")
    trees: list[list[tuple[int, tuple[str, ...], str]]] = []
    for number, text in enumerate(source.text.split("\n"), 1):
        agent, line = _AGENT.fullmatch(text.strip()), _LINE.fullmatch(text.strip())
        if agent is not None:
            if int(agent[1]) != len(trees):
                source.fail(f"agent {len(trees)} was expected, not {agent[1]}", line=number)
            trees.append([])
        elif line is not None:
            if not trees:
                source.fail("a line of a policy precedes the first 'Policy for agent'", line=number)
            trees[-1].append((number, _history(line[1]), line[2].strip()))
        elif trees and trees[-1] and len(trees) == model.num_agents:
            break  # the rest follows the last agent's lines
    if len(trees) != model.num_agents:
        source.fail(f"the file holds policies for {len(trees)} agents, but the model has {model.num_agents}")
    if len(model.observation_space.factors) != model.num_agents:
        source.fail(f"the model needs one observation factor for each of its {model.num_agents} agents")
    factors = zip(trees, model.action_space.factors, model.observation_space.factors, strict=True)
    return JointController(_tree(source, *given) for given in factors)


def write(policy: JointController, path: str | Path, model: MDP | None) -> None:
    """Write a joint policy to a file, as MADP prints it.

    Raises:
        ModelError: If the model does not fit or has no observations, or a controller is not a tree.
    """
    if model is None or model.observation_space is None:
        raise ModelError("a joint policy refers to actions and observations by name: give its POMDP (--model)")
    wrong = policy.mismatch(model)
    if wrong is not None:
        raise ModelError(wrong)
    texts: list[str] = []
    joint = 0
    factors = zip(policy.controllers, model.action_space.factors, model.observation_space.factors, strict=True)
    for agent, (controller, actions, observations) in enumerate(factors):
        for name in (*actions.names, *observations.names):
            if not _NAME.fullmatch(name):
                raise ModelError(
                    f"the name {name!r} cannot be written: the format allows no comma, bracket or arrow in it"
                )
        histories = _histories(controller, observations)
        if len(histories) > controller.num_nodes:
            raise ModelError(f"the controller of agent {agent} is not a tree, which this format requires")
        index = 0
        for node, _ in histories:
            index = (index * len(actions) + controller.action_at(node)) % _INDICES
        joint = (joint * pow(len(actions), len(histories), _INDICES) + index) % _INDICES
        texts.append(f"Policy for agent {agent} (index {index}):\n")
        texts += [f"({','.join(past)}) --> {actions.names[controller.action_at(node)]}\n" for node, past in histories]
    head = f"JointPolicyPureVector: \nJPolComponent_VectorImplementation index {joint}\n"
    write_text(path, head + "".join(texts))


def _histories(controller: FiniteStateController, observations: Factor) -> list[tuple[int, tuple[str, ...]]]:
    """Return a tree's nodes and their histories level by level; more than there are nodes if it is not a tree."""
    histories: list[tuple[int, tuple[str, ...]]] = [(controller.start, ())]
    for node, past in histories:  # the list grows meanwhile
        if len(histories) > controller.num_nodes:
            break
        for observation, after in enumerate(controller.successors[node]):
            if after is not None:
                histories.append((after, (*past, observations.names[observation])))
    return histories


def _history(text: str) -> tuple[str, ...]:
    inner = text.strip().removeprefix("(").removesuffix(")")
    return tuple(word.strip() for word in inner.split(",") if word.strip() not in {"", "Oempty"})


def _tree(
    source: Source, lines: list[tuple[int, tuple[str, ...], str]], actions: Factor, observations: Factor
) -> FiniteStateController:
    nodes: dict[tuple[int, ...], int] = {}
    chosen: list[int] = []
    successors: list[list[int | None]] = []
    for number, words, action in lines:
        try:
            history = tuple(observations.index(word) for word in words)
            chosen.append(actions.index(action))
        except ModelError as error:
            source.fail(str(error), line=number)
        if history in nodes:
            source.fail("this history has a line already", line=number)
        if history and history[:-1] not in nodes:
            source.fail("the history without its last observation has no line before this one", line=number)
        if history:
            successors[nodes[history[:-1]]][history[-1]] = len(nodes)
        nodes[history] = len(nodes)
        successors.append([None] * len(observations))
    if not nodes:
        source.fail(f"the policy of agent {actions.name!r} has no line")
    return FiniteStateController(chosen, successors, len(actions))
