"""Write the demo's models as two-slice networks, and policies for them.

The files are part of the example; run this again after changing a number: ``python make_models.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mdm

HERE = Path(__file__).parent
DISCOUNT_TOP, DISCOUNT_ROOMS = 0.9, 0.95

TASKS = ("Patrol", "Assistance", "Trespassing", "Emergency")
TROUBLES = {
    # what: chance to arise, what ends it (four times out of five), what it costs
    "person": (0.08, "Assistance", 2.0),
    "intruder": (0.04, "Trespassing", 5.0),
    "fire": (0.03, "Emergency", 20.0),
}
ENDS = 0.8
PATROLLING = 1.0

ROOMS = ("Lobby", "Office", "Lab")
FIRES = ("nowhere", *ROOMS)
MOVES = (*(f"Go{room}" for room in ROOMS), "Report")
ARRIVES = 0.95  # of all drives, the rest end where they began
BREAKS_OUT = 0.02  # a fire, in one of the rooms, at each step
SEES_SMOKE = 0.85  # where there is a fire
FALSE_ALARM = 0.1  # where there is none


def top() -> mdm.models.FactoredMDP:
    """Return what the robot attends to: three troubles that come by themselves and go when attended to."""
    tasks = mdm.models.Node("action", 0)
    initial, transitions, utilities = [], [], [mdm.models.Table([tasks], [PATROLLING, 0, 0, 0])]
    for place, (chance, task, cost) in enumerate(TROUBLES.values()):
        now, later = mdm.models.Node("state", place), mdm.models.Node("next_state", place)
        initial.append(mdm.models.Table([now], [0.5, 0.5]))
        arises = mdm.models.Table([now, later], [[1 - chance, chance], [0, 1]])
        attended = mdm.models.Table([now, later], [[1 - chance, chance], [ENDS, 1 - ENDS]])
        transitions.append(mdm.models.Tree(tasks, [int(name == task) for name in TASKS], [arises, attended]))
        utilities.append(mdm.models.Table([now], [0, -cost]))
    states = mdm.models.Space(mdm.models.Factor(name, ["no", "yes"]) for name in TROUBLES)
    network = mdm.models.TwoSliceNetwork(
        states,
        mdm.models.Space.single("robot", TASKS),
        initial=initial,
        transitions=transitions,
        utilities=utilities,
    )
    return mdm.models.FactoredMDP(network, discount=DISCOUNT_TOP)


def rooms() -> mdm.models.FactoredPOMDP:
    """Return where the robot is, which room burns, and what the robot's camera sees."""
    robot, fire, move = mdm.models.Node("state", 0), mdm.models.Node("state", 1), mdm.models.Node("action", 0)
    robot_later, fire_later = mdm.models.Node("next_state", 0), mdm.models.Node("next_state", 1)
    stays = mdm.models.Table([robot, robot_later], np.eye(len(ROOMS)))
    drives = [mdm.models.Table([robot, robot_later], _drive(target)) for target in range(len(ROOMS))]
    burns = np.eye(len(FIRES))
    burns[0] = [1 - BREAKS_OUT, *[BREAKS_OUT / len(ROOMS)] * len(ROOMS)]
    put_out = mdm.models.Table([fire_later], np.eye(len(FIRES))[0])  # by whoever gets the report
    spreads = mdm.models.Table([fire, fire_later], burns)
    here = np.equal.outer(ROOMS, FIRES)  # rooms x fires: whether it burns where the robot is
    smoke = np.where(here, SEES_SMOKE, FALSE_ALARM)
    camera = mdm.models.Node("observation", 0)
    sees = mdm.models.Table([robot_later, fire_later, camera], np.stack([1 - smoke, smoke, 0 * smoke], axis=-1))
    reported = mdm.models.Table([camera], [0, 0, 1])
    report = np.where(here, 20.0, -20.0)
    report[:, 0] = -40  # a false report
    network = mdm.models.TwoSliceNetwork(
        mdm.models.Space([mdm.models.Factor("robot", ROOMS), mdm.models.Factor("fire", FIRES)]),
        mdm.models.Space.single("move", MOVES),
        mdm.models.Space.single("camera", ["Clear", "Smoke", "Reported"]),
        initial=[
            mdm.models.Table([robot], np.full(len(ROOMS), 1 / len(ROOMS))),
            mdm.models.Table([fire], np.eye(len(FIRES))[0]),
        ],
        transitions=[
            mdm.models.Tree(move, [0, 1, 2, 3], [*drives, stays]),
            mdm.models.Tree(move, [0, 0, 0, 1], [spreads, put_out]),
        ],
        observation=[mdm.models.Tree(move, [0, 0, 0, 1], [sees, reported])],
        utilities=[
            mdm.models.Tree(
                move,
                [0, 0, 0, 1],
                [mdm.models.Table([fire], [-1, -5, -5, -5]), mdm.models.Table([robot, fire], report)],
            )
        ],
    )
    return mdm.models.FactoredPOMDP(network, discount=DISCOUNT_ROOMS)


def _drive(target: int) -> np.ndarray:
    """Return where a drive to a room ends, from each room."""
    matrix = (1 - ARRIVES) * np.eye(len(ROOMS))
    matrix[:, target] += ARRIVES
    return matrix


def solve_mdp(model: mdm.models.MDP, sweeps: int = 500) -> list[int]:
    """Return the best action in each state, by value iteration."""
    value = np.zeros(len(model.state_space))
    transitions = np.stack([model.transition_matrix(a) for a in range(len(model.action_space))])
    for _ in range(sweeps):
        values = model.rewards + model.discount * (transitions @ value).T
        value = values.max(axis=1)
    return [int(action) for action in values.argmax(axis=1)]


def solve_pomdp(model: mdm.models.POMDP, beliefs: int = 150, sweeps: int = 120) -> tuple[np.ndarray, list[int]]:
    """Return alpha vectors and their actions, by point-based value iteration over reachable beliefs."""
    count = len(model.action_space)
    transitions = np.stack([model.transition_matrix(a) for a in range(count)])
    observations = np.stack([model.observation_matrix(a) for a in range(count)])
    points = _reachable(model, beliefs)
    lowest = model.rewards.min() / (1 - model.discount)
    vectors, actions = np.full((1, len(model.state_space)), lowest), [0]
    for _ in range(sweeps):
        # g[a, o, i, s]: the discounted worth of vector i after action a and observation o
        g = model.discount * np.einsum("ast,ato,it->aois", transitions, observations, vectors)
        backed: dict[bytes, tuple[np.ndarray, int]] = {}
        for belief in points:
            best = np.einsum("aois,s->aoi", g, belief).argmax(axis=2)
            candidates = model.rewards.T + np.stack(
                [sum(g[a, o, best[a, o]] for o in range(g.shape[1])) for a in range(count)]
            )
            action = int((candidates @ belief).argmax())
            backed[candidates[action].round(9).tobytes()] = (candidates[action], action)
        vectors = np.stack([vector for vector, _ in backed.values()])
        actions = [action for _, action in backed.values()]
    kept = sorted({int((vectors @ belief).argmax()) for belief in points})
    return vectors[kept], [actions[index] for index in kept]


def _reachable(model: mdm.models.POMDP, count: int) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    tracker = mdm.BeliefTracker(model)
    found = [tracker.belief]
    for _ in range(20 * count):
        if random.random() < 0.05:
            tracker.reset()
        action = int(random.integers(len(model.action_space)))
        chances = tracker.belief @ model.transition_matrix(action) @ model.observation_matrix(action)
        tracker.update(action, int(random.choice(len(chances), p=chances / chances.sum())))
        if all(np.abs(tracker.belief - other).sum() > 1e-3 for other in found):
            found.append(tracker.belief)
    return found[:count]


if __name__ == "__main__":
    mdm.save_model(top(), HERE / "top.pomdpx")
    mdm.save_model(rooms(), HERE / "rooms.pomdpx")
    best = mdm.policies.DeterministicPolicy(solve_mdp(top()), len(TASKS))
    mdm.save_policy(best, HERE / "top.policy")
    alpha, chosen = solve_pomdp(rooms())
    mdm.save_policy(mdm.policies.AlphaVectors(alpha.round(9), chosen, len(MOVES)), HERE / "rooms.vf")
    print(f"top.policy: {best.actions}; rooms.vf: {len(alpha)} vectors for actions {sorted(set(chosen))}")
