"""``mdm evaluate`` and ``mdm compare``: claimed, exact and simulated values of policies in their model."""

from __future__ import annotations

import functools
import math
import sys
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm.cli.files.info import describe_policy
from mdm.cli.policies.inputs import executor_of, load, load_durations_for, load_for, of_run, visibility
from mdm.cli.progress import counting
from mdm.cli.report import as_json, columns
from mdm.cli.usage import UsageError
from mdm.formats.source import suffixes
from mdm.models.matrices import Vector
from mdm.models.units import Unit, in_words, ratio
from mdm.simulation import Comparison, Evaluation, evaluate
from mdm.solvers import exact_values
from mdm.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from concurrent.futures import Executor

    from mdm.models import MDP, Durations

_OWN = ("discount", "discount_of", "durations", "false_negative")
_ROUNDING = 1e-6
_DRAWN = 100
"""The models that are drawn of those that records leave possible."""
_LARGEST = 50_000
"""The entries of T up to which they are."""


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; return the exit status."""
    if suffixes(arguments.model) == ".toml":
        policy, world, durations = of_ensemble(arguments)
    else:
        model = load(arguments.model, arguments.discount, arguments.discount_of)
        durations = load_durations_for(model, arguments.durations)
        policy, world = load_for(model, arguments.policy, arguments)
    if (note := visibility(world, policy)) is not None:
        print(f"mdm evaluate: {note}", file=sys.stderr)
    with executor_of(arguments) as executor:
        verdict = judge(world, policy, arguments, durations, executor=executor)
    from mdm.verification.dangers import avoidable_end  # noqa: PLC0415 - slow to import

    if (danger := avoidable_end(world, policy)) is not None:
        print(f"mdm evaluate: {danger}", file=sys.stderr)
    interrupted = arguments.interruption.number is not None
    if arguments.json:
        print(as_json(verdict.facts() | {"interrupted": interrupted}))
    else:
        for title, text in verdict.lines():
            print(f"{title:20}{text}")
        if interrupted:
            print(f"{'interrupted':20}this is of the episodes that had ended by then")
    missing = verdict.simulated is not None and verdict.simulated.missing > 0
    return arguments.interruption.status if interrupted else int(missing)


def of_ensemble(arguments: argparse.Namespace) -> tuple[Any, MDP, Durations | None]:
    """Return the policy of a TOML file's ensemble, the model that it is for, and how long actions take there."""
    from mdm.cli.robots.ensembles import load_ensembles  # noqa: PLC0415 - a model needs no actors

    for name in _OWN:
        if getattr(arguments, name, None) is not None:
            raise UsageError(f"--{name.replace('_', '-')} is for a model's file; an ensemble has its own")
    system, name = load_ensembles(arguments.model, imports=False), arguments.policy
    if name not in system.ensembles:
        raise UsageError(f"{arguments.model}: there is no ensemble {name!r}; there are {', '.join(system.ensembles)}")
    controller = system.ensembles[name].controller
    if controller.model is None or controller.policy.num_actions != len(controller.model.action_space):
        raise UsageError(f"{arguments.model}: ensemble {name!r} has no model to evaluate all of its policy in")
    return controller.policy, controller.model, system.durations.get(name)


def compare(arguments: argparse.Namespace) -> int:
    """Compare the values of several policies in one model; return the exit status."""
    if arguments.seed is None:
        arguments.seed = int(np.random.SeedSequence().generate_state(1)[0])
    model = load(arguments.model, arguments.discount, arguments.discount_of)
    durations = load_durations_for(model, arguments.durations)
    pairs = [load_for(model, path, arguments) for path in arguments.policies]
    for note in filter(None, dict.fromkeys(visibility(world, policy) for policy, world in pairs)):
        print(f"mdm compare: {note}", file=sys.stderr)
    verdicts: list[tuple[str, Verdict]] = []
    with executor_of(arguments) as executor:
        for place, (policy, world) in enumerate(pairs, 1):
            told = f"policy {place} of {len(pairs)}  "
            verdict = judge(world, policy, arguments, durations, simulated=True, what=told, executor=executor)
            verdicts.append((arguments.policies[place - 1], verdict))
            if interrupted := arguments.interruption.number is not None:
                break
    first = verdicts[0][1]
    facts, known = [], []
    table: list[tuple[str, ...]] = [("policy", "claimed", "exact", "simulated", "", "difference", "")]
    for path, verdict in verdicts:
        result = verdict.simulated
        assert result is not None
        assert first.simulated is not None
        difference, within = Comparison((first.simulated, result)).difference(1)
        if verdict.exact is not None and first.exact is not None:
            difference, within = verdict.exact[0] - first.exact[0], 0.0
        row = {"policy": path} | verdict.facts()
        row |= {"difference": difference, "difference_within": within, "interrupted": interrupted}
        half = (result.interval[1] - result.interval[0]) / 2
        values = (verdict.claimed, verdict.exact and verdict.exact[0], result.mean)
        cells = ("" if value is None else f"{value:.6g}" for value in values)
        table.append((path, *cells, f"± {half:.2g}", f"{difference:+.4g}", f"± {within:.2g}"))
        if verdict.possible is not None and first.possible is not None:
            (low, high), (less, more) = _between(verdict.possible), _between(verdict.possible - first.possible)
            row["difference_possible"] = [less, more]
            beside = "" if verdict is first else f", difference {less:+.4g} to {more:+.4g}"
            known.append(f"{path} by the model's records: {low:.4g} to {high:.4g}{beside}")
        facts.append(row)
    status = arguments.interruption.status if interrupted else int(any(row.get("missing") for row in facts))
    if arguments.json:
        print(as_json(facts))
        return status
    print("\n".join([*columns(table, range(1, 7)), *known]))
    assert first.simulated is not None
    print(
        f"± is 95 % confidence; {counted(first.simulated.episodes, 'episode')} of at most "
        f"{counted(first.simulated.steps, 'step')} each, seed {arguments.seed}"
    )
    if interrupted:
        assert result is not None
        print(
            f"interrupted: the last policy above has {counted(result.episodes, 'episode')}, and those after it are not "
            f"compared"
        )
    return status


class Verdict(msgspec.Struct, frozen=True):
    """A policy's claimed, exact and simulated values at the initial belief.

    Attributes:
        form: The kind of policy.
        size: Its number of vectors, nodes or states, in words.
        claimed: The value that the policy itself states.
        exact: The exact value, and its minimum and maximum over the states.
        simulated: The result of simulation.
        comparable: Whether the claim is for the same horizon.
        other_unit: In words the unit of the claim's discount, where it cannot be converted into the model's.
        possible: Of an estimated model, the exact values in models that its records leave possible.
    """

    form: str
    size: str
    claimed: float | None
    exact: tuple[float, float, float] | None
    simulated: Evaluation | None
    comparable: bool
    other_unit: str | None = None
    possible: Vector | None = None

    @property
    def contradicts(self) -> int:
        """1 if the claim is too high, -1 if it is too low, 0 if it is not contradicted."""
        if self.claimed is None or not self.comparable or self.other_unit is not None:
            return 0
        if self.exact is not None:
            low = high = self.exact[0]
        else:
            assert self.simulated is not None
            if not self.simulated.episodes:
                return 0
            low, high = self.simulated.interval
        if f"{self.claimed:.6g}" in {f"{low:.6g}", f"{high:.6g}"}:
            return 0  # what reads the same: solvers stop at a gap
        margin = _ROUNDING * max(1.0, abs(low), abs(high))
        return int(self.claimed > high + margin) - int(self.claimed < low - margin)

    def facts(self) -> dict[str, Any]:
        """Return the values, ready for JSON."""
        facts: dict[str, Any] = {"form": self.form, "claim": self.claimed, "exact": None, "mean": None}
        if self.exact is not None:
            facts |= dict(zip(("exact", "exact_min", "exact_max"), self.exact, strict=True))
        result = self.simulated
        if result is not None:
            keys = ("mean", "standard_error", "interval", "episodes", "missing", "steps", "seed")
            facts |= {key: getattr(result, key) for key in keys} | {"run": of_run(result)}
        if self.possible is not None:
            facts["possible"] = _between(self.possible)
        facts["claim_is"] = {1: "too high", -1: "too low"}.get(self.contradicts, "not contradicted")
        return facts

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield titles and texts for printing."""
        yield "policy", f"{self.form}, {self.size}"
        if self.claimed is not None:
            other = "" if self.other_unit is None else f" by a discount of {self.other_unit}: not compared"
            yield "claimed value", f"{self.claimed:.6g} at the start{other}"
        if self.exact is not None:
            yield (
                "exact value",
                f"{self.exact[0]:.6g} at the start, {self.exact[1]:.6g} to {self.exact[2]:.6g} over the states",
            )
        if self.possible is not None:
            low, high = _between(self.possible)
            yield "by its records", f"{low:.6g} to {high:.6g}, in 95 % of the models that they leave possible"
        result = self.simulated
        if result is not None and not result.episodes:
            yield "simulated value", "none: no episode has ended"
        elif result is not None:
            low, high = result.interval
            yield "simulated value", f"{result.mean:.6g}, with 95 % confidence between {low:.6g} and {high:.6g}"
            each = (
                f"{counted(result.episodes, 'episode')} of at most {counted(result.steps, 'step')}, seed {result.seed}"
            )
            yield "", f"{each}, {result.steps_a_second:.3g} steps a second"
            if result.missing:
                yield "missing", f"{counted(result.missing, 'episode')}, of parts that failed"
        if self.contradicts > 0:
            yield "contradiction", "the value is less than claimed, as with an upper bound (such as QMDP's)"
        elif self.contradicts < 0:
            yield "contradiction", "the value is more than claimed, as with a lower bound"


def judge(
    model: MDP,
    policy: Any,
    arguments: argparse.Namespace,
    durations: Durations | None = None,
    *,
    simulated: bool = False,
    what: str = "",
    executor: Executor | None = None,
) -> Verdict:
    """Evaluate a policy.

    Args:
        model: The model, as the policy sees it.
        policy: The policy.
        arguments: The sub-command's arguments.
        durations: How long actions take; by default all take one time step.
        simulated: Simulate even if the exact value is known.
        what: The text of the progress of the simulation.
        executor: Who runs its parts.
    """
    exact_in = functools.partial(exact_values, policy=policy, steps=arguments.steps, durations=durations)
    values = exact_in(model)
    exact = others = None
    if values is not None:
        exact = float(model.initial_belief @ values), float(np.min(values)), float(np.max(values))
        if (
            model.visits is not None
            and model.visits.size * len(values) <= _LARGEST
            and model.discount < 1
            and not model.pomdp
        ):
            from mdm.estimation.reestimation import possible  # noqa: PLC0415 - of an estimated model alone

            drawn = [exact_in(each) for each in possible(model, _DRAWN)]
            others = np.array([model.initial_belief @ each for each in drawn if each is not None])
    result = None
    if simulated or exact is None or arguments.episodes is not None:
        given = {name: getattr(arguments, name) for name in ("episodes", "steps", "seed")}
        with counting(arguments.interruption, what) as progress:
            given |= {"progress": progress, "executor": executor}
            result = evaluate(model, policy, durations=durations, **given)
    facts = describe_policy(policy)
    size = ""
    for noun in ("states", "nodes", "vectors"):
        if noun in facts:
            number = facts[noun]
            size = f"{' and '.join(map(str, number)) if isinstance(number, list) else number} {noun}"
    unit: Unit = getattr(policy, "discount_of", "step")
    other = in_words(unit) if ratio(unit, model.discount_of) is None else None
    comparable = arguments.steps is None
    return Verdict(facts["form"], size, claimed_value(model, policy), exact, result, comparable, other, others)


def _between(values: Vector) -> list[float]:
    """Return the least and the greatest of 95 % of some values."""
    return [float(each) for each in np.quantile(values, [0.025, 0.975])]


def claimed_value(model: MDP, policy: Any) -> float | None:
    """Return the value that a policy states for the initial belief; None if it states none."""
    start = model.initial_belief
    if policy.input != "belief":
        value: float | None = policy.value_at(start)
        return value
    return math.fsum(weight * policy.value(belief) for weight, belief in _first_beliefs(model, start))


def _first_beliefs(model: MDP, start: Vector) -> list[tuple[float, Vector]]:
    """Return the possible beliefs after observing the initial state, with their probabilities."""
    if not model.observed or (pomdp := model.pomdp) is None:
        return [(1.0, start)]
    states = np.flatnonzero(start)
    _, first = np.unique(pomdp.seen_in[states], return_index=True)
    beliefs = [pomdp.belief_at_start(int(state)) for state in states[first]]
    return [(float(start[belief > 0].sum()), belief) for belief in beliefs]
