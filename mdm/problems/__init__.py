"""The field's standard problems as functions, each of which makes a model in any size.

Every name in ``__all__`` is a problem: a function with defaults for all parameters, which returns an MDP or a POMDP.
Its docstring says where the problem is from, how large it is, and what is known of its value.
"""

from mdm.problems.hallway import hallway, hallway2
from mdm.problems.tiger import tiger

__all__ = ["hallway", "hallway2", "tiger"]
