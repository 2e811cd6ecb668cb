"""Bridges to Gymnasium and PettingZoo: models as environments, and tabular environments as models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from mdm.checks import check_choice, check_flag
from mdm.errors import ConfigError, Error
from mdm.gym.table import model
from mdm.loading import model_of

if TYPE_CHECKING:
    from gymnasium import Env
    from pettingzoo import ParallelEnv

    from mdm.loading import GivenModel

__all__ = ["environment", "model", "parallel"]


def environment(
    model: GivenModel,
    observation: Literal["symbol", "belief"] = "symbol",
    steps: int | None = None,
    *,
    factored: bool = False,
) -> Env[Any, Any]:
    """Return a model as an environment of Gymnasium, which passes its ``check_env``.

    Actions are ``Discrete(A)``, those of a team joint ones, by index or name. Where not all are available,
    ``info["action_mask"]`` has those that are, and others are refused. The reward is that of the outcome where the
    model has it, else R(s, a); the learner applies the discount. An episode is ``terminated`` in an absorbing state:
    every action stays there with probability 1 and earns 0. Where a state that is never left earns more, it goes on.

    Args:
        model: The model, or the path of its file. Fully observed factors are shown by ``model.revealed()``.
        observation: ``"symbol"``, the state of an MDP (``Discrete(S)``) or the observation of a POMDP (``Discrete(O +
            1)``; the last is for nothing, as before the first action), or ``"belief"`` (``Box`` of S numbers).
        steps: The steps after which an episode is ``truncated``; by default never.
        factored: Whether actions and symbols are ``MultiDiscrete``, a number for each factor.

    Raises:
        ConfigError: If an argument is none of these, or an MDP is to show beliefs.
        Error: If Gymnasium or PettingZoo is not installed.
        ModelError: If the model's discount is of a second.

    Example::

        env = mdm.gym.environment(mdm.problems.tiger(), observation="belief", steps=100)
        belief, info = env.reset(seed=1)  # [0.5, 0.5]
        belief, reward, terminated, truncated, info = env.step("listen")  # the reward is -1.0
    """
    given, beliefs = model_of(model), observation == "belief"
    check_choice(observation, ("symbol", "belief"), "an environment's observation", key="observation")
    check_flag(factored, "factored", key="factored")
    if beliefs and given.pomdp is None:
        raise ConfigError("an MDP has no beliefs: its environment shows the state's symbol", key="observation")
    return _environments().AgentEnvironment(given, beliefs=beliefs, steps=steps, factored=factored)


def parallel(model: GivenModel, steps: int | None = None) -> ParallelEnv[str, Any, Any]:
    """Return a team's model as a parallel environment of PettingZoo, which passes its ``parallel_api_test``.

    The agents are the factors of the joint actions, with actions by their own indices or names. Each sees its own
    observation of a POMDP, as in `environment`, or the state of an MDP. Rewards and ends are those of the team.

    Args:
        model: The model, with a factor of observations for each agent; or the path of its file.
        steps: The steps after which an episode is ``truncated``; by default never.

    Raises:
        Error: If Gymnasium or PettingZoo is not installed.
        ModelError: If observations are not one for each agent, or the model's discount is of a second.

    Example::

        env = mdm.gym.parallel(mdm.problems.dec_tiger(), steps=10)
        observations, infos = env.reset(seed=1)
        heard, rewards, *_ = env.step({"agent0": "listen", "agent1": "listen"})  # the reward of each is -2.0
    """
    return _environments().TeamEnvironment(model_of(model), steps=steps)


def _environments() -> Any:
    try:
        from mdm.gym import environments  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise Error(f"environments need {error.name}: pip install gymnasium pettingzoo") from None
    return environments
