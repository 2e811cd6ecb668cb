"""The field's standard problems as functions, which make models in any size.

Every name in ``__all__`` is a function with defaults for all parameters, which returns an MDP or a POMDP. Its docstring
has the source, the size, and known optimal values.

A team's problem is one model, with a factor of actions and of observations per agent. It serves both decentralised
plans, each agent on its own observations (``mdm.solve(model, "jesp", horizon=3)``), and centralised policies on shared
observations (``mdm.solve(model)``).
"""

from mdm.problems.box_pushing import box_pushing
from mdm.problems.fire_fighting import fire_fighting, fire_fighting_graph
from mdm.problems.grids import grid_world, hallway, hallway2, tag
from mdm.problems.machine_maintenance import machine_maintenance
from mdm.problems.pairs import broadcast_channel, recycling_robots, relay
from mdm.problems.patrol import patrol
from mdm.problems.rock_sample import field_vision_rock_sample, rock_sample
from mdm.problems.rovers import grid_small, mars_rovers, meeting
from mdm.problems.small import aloha, forest, load_unload, river_swim
from mdm.problems.tiger import dec_tiger, tiger

__all__ = [
    "aloha",
    "box_pushing",
    "broadcast_channel",
    "dec_tiger",
    "field_vision_rock_sample",
    "fire_fighting",
    "fire_fighting_graph",
    "forest",
    "grid_small",
    "grid_world",
    "hallway",
    "hallway2",
    "load_unload",
    "machine_maintenance",
    "mars_rovers",
    "meeting",
    "patrol",
    "recycling_robots",
    "relay",
    "river_swim",
    "rock_sample",
    "tag",
    "tiger",
]
