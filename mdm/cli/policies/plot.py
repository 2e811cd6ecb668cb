"""``mdm plot``: plots of a solver's bounds, of a policy, and of a belief over an episode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mdm.cli.usage import UsageError, add_discount, add_false_negative, complete, count, seed

if TYPE_CHECKING:
    import argparse

__all__ = ["add_parser", "run"]


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add the verb, its kinds of pictures and their arguments."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "plot",
        help="draw bounds over time, a policy, or a belief over an episode",
        description="Draw a picture (needs mdm[plot]); its file's suffix is .png, .svg or .pdf.",
        epilog="example: mdm plot policy tiger.pomdp tiger.vf -o tiger.png",
    )
    kinds = parser.add_subparsers(dest="picture", metavar="PICTURE", required=True)
    bounds = _kind(
        kinds,
        "bounds",
        "the bounds of solvers over time",
        "Draw the bounds over time of one or several runs, from the files of mdm solve --history.",
        "mdm plot bounds sarsop.json perseus.json -o bounds.png",
    )
    bounds.add_argument("histories", metavar="HISTORY.json", nargs="+", help="a file written by mdm solve --history")
    policy = _kind(
        kinds,
        "policy",
        "the actions and values of a policy",
        "Draw the actions and values of a policy: over the states of an MDP or a factored model, as a grid of two "
        "factors, or over beliefs in two states.",
        "mdm plot policy tiger.pomdp tiger.vf -o tiger.png",
    )
    _add_inputs(policy)
    policy.add_argument(
        "--states",
        metavar=("A", "B"),
        nargs=2,
        help="draw over beliefs in these two states; by default those that are most often confused",
    )
    policy.add_argument("--axes", metavar=("DOWN", "ACROSS"), nargs=2, help="draw over these two factors of the state")
    policy.add_argument("--columns", metavar="N", type=count, help="lay states without factors out in rows of N")
    belief = _kind(
        kinds,
        "belief",
        "a belief over an episode",
        "Draw the belief over one simulated episode, with true states, actions and observations.",
        "mdm plot belief tiger.pomdp tiger.vf -o belief.png --seed 1",
    )
    _add_inputs(belief)
    belief.add_argument("--steps", metavar="H", type=count, default=25, help="decisions (25)")
    for each in (policy, belief):
        each.add_argument("--seed", metavar="S", type=seed, default=0, help="of the simulated episodes (0)")
        add_false_negative(each)
    return parser


def _kind(kinds: Any, name: str, summary: str, description: str, example: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = kinds.add_parser(
        name, help=summary, description=description, epilog=f"example: {example}"
    )
    parser.add_argument("-o", "--output", metavar="PNG", required=True, help="the picture's file")
    complete(parser, "plot")
    return parser


def _add_inputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="a model")
    parser.add_argument("policy", metavar="POLICY", help="a policy for it")
    add_discount(parser)


def run(arguments: argparse.Namespace) -> int:
    """Draw the picture; return the exit status."""
    from mdm.views.canvas import check_picture, keep, pyplot  # noqa: PLC0415 - `mdm --help` needs no numpy

    pyplot()
    bounds = arguments.picture == "bounds"
    check_picture(arguments.output, *(arguments.histories if bounds else (arguments.model, arguments.policy)))
    if bounds:
        from mdm.views.bounds import bounds_figure  # noqa: PLC0415

        figure = bounds_figure(arguments.histories)
    else:
        figure = _of_policy(arguments)
    keep(figure, arguments.output)
    print(f"{arguments.output}: drawn")
    return 0


def _of_policy(arguments: argparse.Namespace) -> Any:
    from mdm.cli.policies.inputs import load, load_for  # noqa: PLC0415
    from mdm.errors import Error  # noqa: PLC0415
    from mdm.views.belief import belief_figure, two_state_figure  # noqa: PLC0415
    from mdm.views.grid import grid_figure  # noqa: PLC0415

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
        return two_state_figure(model, policy, arguments.states, arguments.seed)
    if policy.input != "belief":
        raise Error(f"{arguments.policy}: the policy sees the state; there is no belief to draw")
    return belief_figure(model, policy, arguments.steps, arguments.seed)
