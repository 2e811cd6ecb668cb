"""The field's standard problems as functions, each of which makes a model in any size.

Every name in ``__all__`` is a problem: a function with defaults for all parameters, which returns an MDP or a POMDP.
Its docstring says where the problem is from, how large it is, and what is known of its value.
"""

from mdm.problems.aloha import aloha
from mdm.problems.forest import forest
from mdm.problems.grid_world import grid_world
from mdm.problems.hallway import hallway, hallway2
from mdm.problems.load_unload import load_unload
from mdm.problems.machine_maintenance import machine_maintenance
from mdm.problems.river_swim import river_swim
from mdm.problems.rock_sample import field_vision_rock_sample, rock_sample
from mdm.problems.tag import tag
from mdm.problems.tiger import tiger

__all__ = [
    "aloha",
    "field_vision_rock_sample",
    "forest",
    "grid_world",
    "hallway",
    "hallway2",
    "load_unload",
    "machine_maintenance",
    "river_swim",
    "rock_sample",
    "tag",
    "tiger",
]
