"""Step 3, a model and its policy: the map says what leads where, a tour what is worth it, and a solver what to do."""

from floor import FLOOR, ROOMS

import mdm
from mdm.maps.model import model, visits

patrol = model(FLOOR.graph, factors=[visits(FLOOR.graph, ROOMS)], success=0.9)
solution = mdm.solve(patrol)

if __name__ == "__main__":
    print(f"{len(patrol.state_space)} states, {len(patrol.action_space)} actions")
    print(f"the policy is worth {solution.lower:.2f}, and none more than {solution.upper:.2f}")
    for place, following in (("LRM", "CoffeeRoom"), ("SouthCorridor", "CoffeeRoom"), ("SouthCorridor", "LRM")):
        state = patrol.state_space.ravel((ROOMS.index(place), ROOMS.index(following)))
        action = patrol.action_space.names[solution.policy.action(state)]
        print(f"in {place}, when {following} is next: {action}")
