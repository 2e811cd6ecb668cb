"""Archives of arrays, `.npz`: models and policies of every kind, with their names; and durations."""
