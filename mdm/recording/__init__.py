"""Records: what happened in a run, so that it can be looked at and run again."""
