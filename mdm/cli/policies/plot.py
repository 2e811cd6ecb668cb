"""``mdm plot``: plots of bounds, of a policy, of a belief over an episode, of a sweep, and of a recorded run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdm.cli.policies.inputs import load, load_for
from mdm.cli.usage import UsageError
from mdm.config.sweep import read_journal
from mdm.errors import Error
from mdm.formats.target import check_place, replacing

if TYPE_CHECKING:
    import argparse


def run(arguments: argparse.Namespace) -> int:
    """Draw the picture; return the exit status."""
    from mdm.views.canvas import check_picture, keep, pyplot  # noqa: PLC0415 - the extra mdm[plot]

    if arguments.picture == "policy" and arguments.graph:
        return _graph(arguments)
    pyplot()
    flaws: tuple[str, ...] = ()
    if arguments.picture in {"bounds", "sweep"}:
        from mdm.views.figures import bounds_figure, sweep_figure  # noqa: PLC0415

        if arguments.picture == "bounds":
            check_picture(arguments.output, *arguments.histories)
            figure = bounds_figure(arguments.histories)
        else:
            journal = Path(arguments.results).with_suffix(".jsonl")
            check_picture(arguments.output, arguments.results, str(journal))
            figure = sweep_figure([*read_journal(journal)[1].values()], arguments.x, arguments.y, arguments.by)
    elif arguments.picture == "run":
        from mdm.recording.reader import Record  # noqa: PLC0415
        from mdm.views.run import run_figure  # noqa: PLC0415

        check_picture(arguments.output, arguments.record)
        record = Record(arguments.record)
        figure = run_figure(record, arguments.ensemble, since=arguments.since, until=arguments.until)
        flaws = record.flaws
    else:
        check_picture(arguments.output, arguments.model, arguments.policy)
        figure = _of_policy(arguments)
    keep(figure, arguments.output)
    print(f"{arguments.output}: drawn")
    for sentence in flaws:
        print(sentence)
    return 0


def _graph(arguments: argparse.Namespace) -> int:
    """Draw the policy as a graph, as a page does, with the first decision lit where the first state is known."""
    from mdm.views.figures import policy_graph, vector_image  # noqa: PLC0415

    if given := [name for name in ("states", "axes", "columns", "seed") if getattr(arguments, name) is not None]:
        raise UsageError(f"--graph and --{given[0]} ask for different pictures")
    check_place(arguments.output, arguments.model, arguments.policy)
    if not arguments.output.lower().endswith(".svg"):
        raise Error(f"{arguments.output}: a graph is written as SVG: give its file the suffix .svg")
    policy, model = load_for(load(arguments.model, arguments.discount), arguments.policy, arguments)
    picture = policy_graph(model, policy)
    if not picture.shapes:
        raise Error(f"{arguments.policy}: {picture.title}: {'; '.join(picture.remarks)}")
    with replacing(arguments.output) as file:
        file.write(vector_image(picture, model.action_space.names[:1000]).encode())
    print("\n".join([f"{arguments.output}: drawn, {picture.title}", *picture.remarks]))
    return 0


def _of_policy(arguments: argparse.Namespace) -> Any:
    from mdm.views.figures import (  # noqa: PLC0415
        belief_figure,
        grid_figure,
        two_state_figure,
    )

    policy, model = load_for(load(arguments.model, arguments.discount), arguments.policy, arguments)
    if policy.input == "observation":
        raise Error(f"{arguments.policy}: a finite-state controller has no action for a state or belief")
    if arguments.picture == "policy":
        given = [name for name in ("states", "axes", "columns") if getattr(arguments, name) is not None]
        if len(given) > 1:
            raise UsageError(f"--{given[0]} and --{given[1]} ask for different pictures")
        by_state = policy.input == "state"
        if by_state and arguments.states is not None:
            raise UsageError("--states is for policies over beliefs; this one is over states")
        if by_state or (given and given != ["states"]) or (not given and len(model.state_space.factors) > 1):
            return grid_figure(model, policy, arguments.axes, arguments.columns)
        return two_state_figure(model, policy, arguments.states, arguments.seed or 0)
    if policy.input != "belief":
        raise Error(f"{arguments.policy}: the policy sees the state; there is no belief to draw")
    return belief_figure(model, policy, arguments.steps, arguments.seed or 0)
