"""Control: a controller with a drive, its planner, and its output."""
