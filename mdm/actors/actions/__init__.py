"""The action layer: the lives of actions, the code that they stand for, and the layer that runs it."""
