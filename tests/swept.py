"""Models and metrics that sweeps of tests name, in a module that workers import."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from mdm.models import MDP


def walk(slip, goal=1.0):
    """Return a model of three states: the action goes on, or slips."""
    go = [[slip, 1 - slip, 0], [0, slip, 1 - slip], [0, 0, 1]]
    names = {"states": ["start", "slip", "goal"], "actions": ["wait", "move"]}
    stay = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    return MDP([stay, go], [[0, -0.1], [0, goal], [0, 0]], discount=0.9, initial_belief=[1, 0, 0], **names)


def sure(model, policy):
    """Return how probable it is that the first move does not slip."""
    return 1 - model.transition("move", "start", "start") if policy.action(0) else 0


def perishing(model, policy):
    """Kill the process at three points of a hundred, each once; a folder keeps which."""
    slip = model.transition("move", "start", "start")
    for place in (0.11, 0.43, 0.97):
        mark = Path(os.environ["MDM_TEST_MARKS"]) / str(place)
        if abs(slip - place) < 1e-9 and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return slip


def wrong(model, policy):
    """Fail where the model slips often, and return no number where it slips seldom."""
    slip = model.transition("move", "start", "start")
    if slip > 0.4:
        raise ValueError("too slippery")
    return "none" if slip < 0.2 else slip
