"""Write the model of the patrol's rooms, and the policies of both models.

The files are part of the example; run this again after changing a number: ``python make_models.py``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mdm

HERE = Path(__file__).parent
ROOMS = ("Lobby", "Office", "Lab")
FIRES = ("nowhere", *ROOMS)
ARRIVES = 0.95  # of all drives, the rest end where they began
BREAKS_OUT = 0.02  # a fire, in one of the rooms, at each step
SEES_SMOKE = 0.85  # where there is a fire
FALSE_ALARM = 0.1  # where there is none


def write_rooms() -> None:
    """Write ``rooms.pomdp``: where the robot is, which room burns, what it sees."""
    names = [f"{room}.{fire}" for room in ROOMS for fire in FIRES]
    actions = [*(f"Go{room}" for room in ROOMS), "Report"]
    lines = [
        "# A robot drives from room to room and looks for fires; written by make_models.py.",
        "# A state is 'where the robot is'.'which room is on fire'.",
        "discount: 0.95",
        "values: reward",
        f"states: {' '.join(names)}",
        f"actions: {' '.join(actions)}",
        "observations: Clear Smoke Reported",
        "start include: Lobby.nowhere Office.nowhere Lab.nowhere",
        "",
    ]
    for room in ROOMS:
        for fire in FIRES:
            for action in actions:
                for target, drive in _drive(room, action).items():
                    for after, chance in _burn(fire, action).items():
                        lines.append(f"T: {action} : {room}.{fire} : {target}.{after} {drive * chance:.12g}")
    for room in ROOMS:
        for fire in FIRES:
            smoke = SEES_SMOKE if room == fire else FALSE_ALARM
            lines.append(f"O: * : {room}.{fire}\n{1 - smoke:.12g} {smoke:.12g} 0")
    lines.append("O: Report : *\n0 0 1")
    for fire in FIRES:
        for room in ROOMS:
            burning = 0 if fire == "nowhere" else -4
            lines += [f"R: {action} : {room}.{fire} : * : * {burning - 1}" for action in actions[:-1]]
            report = -40 if fire == "nowhere" else 20 if fire == room else -20
            lines.append(f"R: Report : {room}.{fire} : * : * {report}")
    (HERE / "rooms.pomdp").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _drive(room: str, action: str) -> dict[str, float]:
    target = action.removeprefix("Go")
    return {room: 1.0} if action == "Report" or target == room else {target: ARRIVES, room: 1 - ARRIVES}


def _burn(fire: str, action: str) -> dict[str, float]:
    if action == "Report":
        return {"nowhere": 1.0}  # whoever gets the report puts the fire out
    if fire != "nowhere":
        return {fire: 1.0}
    return {"nowhere": 1 - BREAKS_OUT, **dict.fromkeys(ROOMS, BREAKS_OUT / len(ROOMS))}


def solve_mdp(model: mdm.MDP, sweeps: int = 500) -> list[int]:
    """Return the best action in each state, by value iteration."""
    value = np.zeros(len(model.state_space))
    transitions = np.stack([model.transition_matrix(a) for a in range(len(model.action_space))])
    for _ in range(sweeps):
        values = model.rewards + model.discount * (transitions @ value).T
        value = values.max(axis=1)
    return [int(action) for action in values.argmax(axis=1)]


def solve_pomdp(model: mdm.POMDP, beliefs: int = 150, sweeps: int = 120) -> tuple[np.ndarray, list[int]]:
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


def _reachable(model: mdm.POMDP, count: int) -> list[np.ndarray]:
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
    write_rooms()
    best = solve_mdp(mdm.load_model(HERE / "top.mdp"))
    (HERE / "top.policy").write_text(f"[{len(best)}]({','.join(map(str, best))})\n", encoding="utf-8")
    alpha, chosen = solve_pomdp(mdm.load_model(HERE / "rooms.pomdp"))  # type: ignore[arg-type]
    blocks = [
        f"{action} -1\n{' '.join(f'{value:.12g}' for value in vector)}\n"
        for vector, action in zip(alpha, chosen, strict=True)
    ]
    (HERE / "rooms.vf").write_text("\n".join(blocks), encoding="utf-8")
    print(f"top.policy: {best}; rooms.vf: {len(alpha)} vectors for actions {sorted(set(chosen))}")
