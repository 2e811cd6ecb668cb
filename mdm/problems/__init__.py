"""The field's standard problems as functions, which make models in any size.

Every name in ``__all__`` is a function with defaults for all parameters, which returns an MDP or a POMDP. Its docstring
has the source, the size, and known optimal values.

A team's problem is one model, with a factor of actions and of observations per agent. It serves both decentralised
plans, each agent on its own observations (``mdm.solve(model, "jesp", horizon=3)``), and centralised policies on shared
observations (``mdm.solve(model)``).
"""

from mdm.problems.aloha import aloha
from mdm.problems.box_pushing import box_pushing
from mdm.problems.broadcast_channel import broadcast_channel
from mdm.problems.dec_tiger import dec_tiger
from mdm.problems.fire_fighting import fire_fighting, fire_fighting_graph
from mdm.problems.forest import forest
from mdm.problems.grid_world import grid_world
from mdm.problems.hallway import hallway, hallway2
from mdm.problems.load_unload import load_unload
from mdm.problems.machine_maintenance import machine_maintenance
from mdm.problems.mars_rovers import mars_rovers
from mdm.problems.meeting import grid_small, meeting
from mdm.problems.patrol import patrol
from mdm.problems.recycling_robots import recycling_robots
from mdm.problems.relay import relay
from mdm.problems.river_swim import river_swim
from mdm.problems.rock_sample import field_vision_rock_sample, rock_sample
from mdm.problems.tag import tag
from mdm.problems.tiger import tiger

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
