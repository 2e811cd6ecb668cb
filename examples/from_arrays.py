"""Models from arrays: a machine that wears out, first as an MDP whose state is seen, then as a POMDP.

Both are solved with `mdm.solve` and run by `mdm.Controller`, without sensors, actors or a clock.
"""

import numpy as np

import mdm

STATES = ["good", "worn"]
ACTIONS = ["produce", "repair"]

transitions = np.array(  # T(s' | s, a): actions x states x next states
    [
        [[0.9, 0.1], [0.0, 1.0]],  # produce: a good machine wears out once in ten times
        [[1.0, 0.0], [1.0, 0.0]],  # repair
    ]
)
rewards = np.array(  # R(s, a): states x actions
    [
        [1.0, -2.0],  # good
        [0.2, -2.0],  # worn
    ]
)
observations = np.array(  # O(o | a, s'): actions x next states x observations
    [
        [[0.9, 0.1], [0.4, 0.6]],  # produce: products of a worn machine are often faulty
        [[0.5, 0.5], [0.5, 0.5]],  # repair: nothing is learnt
    ]
)


def seen() -> None:
    """Solve the MDP, and decide on states."""
    model = mdm.models.MDP(transitions, rewards, discount=0.95, states=STATES, actions=ACTIONS)
    solution = mdm.solve(model)
    controller = mdm.Controller(solution.policy, model)
    for state in STATES:
        print(f"the machine is {state}: {controller.see(state).action_name}")


def unseen() -> None:
    """Solve the POMDP, and decide on beliefs."""
    model = mdm.models.POMDP(
        transitions,
        observations,
        rewards,
        discount=0.95,
        states=STATES,
        actions=ACTIONS,
        observation_names=["fine", "faulty"],
        initial_belief=[1.0, 0.0],
    )
    solution = mdm.solve(model, gap=0.1)
    print(f"value of the best policy: {solution.lower:.2f}")
    controller = mdm.Controller(solution.policy, model)
    controller.start()
    for observation in ("fine", "faulty", "faulty", "fine"):
        step = controller.observe(observation)
        assert controller.belief is not None
        print(f"{observation}: worn with probability {controller.belief[1]:.2f}, {step.action_name}")


if __name__ == "__main__":
    seen()
    unseen()
